"""Runs on disk: whole or absent after a crash, numbered without gaps, and one end each."""

import json
import subprocess
import sys

import pytest

from freerein.errors import AlreadyExists, InvalidInput, NotFound
from freerein.types.orchestrator import StartRunRequest
from freerein_orchestrator.runs.records import RunRecords

REQUEST = StartRunRequest("ppo", {"seed": 3}, "key")


@pytest.fixture
def records(tmp_path):
    return RunRecords(tmp_path)


def test_a_request_is_on_disk_with_its_configuration_when_it_has_an_id(records):
    run_id = records.add(REQUEST, {"seed": 3, "steps": 10}, steps=10)
    assert json.loads((records.folder(run_id) / "config.json").read_bytes()) == {
        "kind": "ppo",
        "config": {"seed": 3, "steps": 10},
        "steps": 10,
    }
    assert records.watch(run_id).read()[0].state == "queued"


def test_a_key_has_one_id_for_one_request_and_no_key_a_new_one_each_time(records):
    run_id = records.add(REQUEST, {"seed": 3})
    assert records.add(REQUEST, {"seed": 3}) == run_id
    assert len(records.watch(run_id).read()) == 1
    with pytest.raises(AlreadyExists):
        records.add(StartRunRequest("ppo", {"seed": 4}, "key"), {"seed": 4})
    unnamed = StartRunRequest("ppo", {})
    assert records.add(unnamed, {}) != records.add(unnamed, {})


def test_a_tail_reads_each_event_once_and_numbers_go_on(records):
    run_id = records.add(REQUEST, {})
    tail = records.watch(run_id)
    assert [event.sequence for event in tail.read()] == [0]
    records.note(run_id, "running", step=1, metrics={"loss": 0.5})
    records.note(run_id, "running", step=2)
    events = tail.read()
    assert [(event.sequence, event.step) for event in events] == [(1, 1), (2, 2)]
    assert events[1].metrics == {"loss": 0.5}
    assert tail.read() == []


def test_an_end_is_noted_once_and_only_queueing_follows_it(records):
    run_id = records.add(REQUEST, {})
    records.note(run_id, "cancelled")
    records.note(run_id, "running", step=9)  # from a worker that has not heard yet
    records.note(run_id, "failed", reason="late")
    assert [event.state for event in records.watch(run_id).read()] == ["queued", "cancelled"]
    records.note(run_id, "queued")
    records.note(run_id, "running")
    records.note(run_id, "running")
    assert [event.state for event in records.watch(run_id).read()] == ["queued", "cancelled", "queued", "running"]


@pytest.mark.fault("O3")
def test_a_line_torn_by_a_crash_is_never_read_and_is_cut_off_before_the_next(records):
    run_id = records.add(REQUEST, {})
    path = records.folder(run_id) / "events.jsonl"
    whole = path.read_bytes()
    path.write_bytes(whole + b'{"state": "runn')
    tail = records.watch(run_id)
    assert [event.state for event in tail.read()] == ["queued"]
    assert records.last(run_id).state == "queued"
    records.note(run_id, "running", step=1)
    assert [(event.sequence, event.step) for event in tail.read()] == [(1, 1)]
    assert path.read_bytes().count(b"\n") == 2


def test_processes_append_side_by_side_without_losing_an_event(records):
    run_id = records.add(REQUEST, {})
    program = (
        "import sys; from pathlib import Path; from freerein_orchestrator.runs.records import RunRecords\n"
        "for step in range(20): RunRecords(Path(sys.argv[1])).note(sys.argv[2], 'running', step=step, "
        "metrics={sys.argv[3]: 1.0})"
    )
    root = records.folder(run_id).parent
    writers = [subprocess.Popen([sys.executable, "-c", program, str(root), run_id, name]) for name in "ab"]
    assert [writer.wait(30) for writer in writers] == [0, 0]
    events = records.watch(run_id).read()
    assert len(events) == 41
    assert {name for event in events for name in event.metrics} == {"a", "b"}


def test_artifacts_are_listed_by_name_and_found_only_below_their_folder(records):
    run_id = records.add(REQUEST, {})
    folder = records.folder(run_id) / "artifacts"
    folder.mkdir()
    (folder / "policy.safetensors").write_bytes(b"1234")
    (folder / ".policy.safetensors.tmp").write_bytes(b"12")
    assert [(artifact.name, artifact.size) for artifact in records.artifacts(run_id)] == [("policy.safetensors", 4)]
    assert records.artifact(run_id, "policy.safetensors").read_bytes() == b"1234"
    with pytest.raises(NotFound):
        records.artifact(run_id, "other")
    with pytest.raises(InvalidInput):
        records.artifact(run_id, "../config.json")
    with pytest.raises(InvalidInput):
        records.folder("../../etc")
