"""Jobs on disk: whole or absent after a crash, events numbered without gaps, and one end each."""

import json
import math
import resource
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from freerein import wire
from freerein.errors import AlreadyExists, InvalidInput, NotFound
from freerein.jobs.json_lines import LineReader, append, last_document
from freerein.jobs.metrics import MetricsWriter
from freerein.jobs.names import job_name
from freerein.jobs.store import JobEvent, JobStore
from freerein.types.jobs import JobMetrics, JobMetricsRequest
from freerein.types.orchestrator import ListRunsResponse, Run

START = {"kind": "ppo", "config": {}, "idempotency_key": ""}
REQUEST = {**START, "config": {"seed": 3}, "idempotency_key": "key"}


@pytest.fixture
def store(tmp_path):
    return JobStore(tmp_path, noun="run", clock_ns=lambda: 7)


def test_a_request_is_on_disk_with_its_configuration_when_it_has_an_id(store):
    config = {"kind": "ppo", "config": {"seed": 3, "steps": 10}, "steps": 10}
    run_id = store.create(REQUEST, config)
    assert json.loads((store.folder(run_id) / "config.json").read_bytes()) == store.config(run_id) == config
    assert store.events(run_id)() == [JobEvent(time_ns=7)]


def test_a_key_has_one_id_for_one_request_and_no_key_a_new_one_each_time(store):
    run_id = store.create(REQUEST, {"seed": 3})
    assert store.create(REQUEST, {"seed": 3}) == run_id
    assert len(store.events(run_id)()) == 1
    with pytest.raises(AlreadyExists):
        store.create({**START, "config": {"seed": 4}, "idempotency_key": "key"}, {"seed": 4})
    unnamed = START
    assert store.create(unnamed, {}) != store.create(unnamed, {})


def test_each_event_is_read_once_and_watchers_come_back_for_the_rest(store):
    run_id = store.create(REQUEST, {})
    read = store.events(run_id)
    assert read() == [JobEvent(time_ns=7)]
    store.record(run_id, "running", step=1, metrics={"loss": 0.5})
    store.record(run_id, "running", step=2)
    assert read() == [JobEvent("running", step, {"loss": 0.5}, time_ns=7) for step in (1, 2)]
    assert read() == []


@pytest.mark.parametrize(("from_sequence", "seen"), [(3, [3, 4]), (5, []), (9, [])])
async def test_a_watcher_that_comes_back_parses_no_event_that_it_has_seen(store, from_sequence, seen):
    run_id = store.create(REQUEST, {})
    for step in (1, 2, 3):
        store.record(run_id, "running", step=step)
    store.record(run_id, "cancelled")
    path = store.folder(run_id) / "events.jsonl"
    path.write_bytes(b"no JSON\n" * 2 + b"".join(path.read_bytes().splitlines(keepends=True)[2:]))

    async def pause(_is_new: bool) -> bool:
        pytest.fail("the job has ended")

    events = store.watch(run_id, from_sequence=from_sequence, pause=pause)
    assert [sequence async for sequence, _ in events] == seen


async def test_a_stream_of_events_ends_when_the_job_is_deleted(store):
    run_id = store.create(REQUEST, {})

    async def delete(_is_new: bool) -> bool:
        shutil.rmtree(store.folder(run_id))
        return True

    events = store.watch(run_id, from_sequence=0, pause=delete)
    assert (await anext(events))[0] == 0
    with pytest.raises(NotFound):
        await anext(events)


def test_an_end_is_noted_once_and_only_queueing_follows_it(store):
    run_id = store.create(REQUEST, {})
    store.record(run_id, "cancelled")
    store.record(run_id, "running", step=9)  # from a worker that has not heard yet
    store.record(run_id, "failed", error="late")
    assert [event.state for event in store.events(run_id)()] == ["queued", "cancelled"]
    store.record(run_id, "queued")
    store.record(run_id, "running")
    store.record(run_id, "running")
    assert [event.state for event in store.events(run_id)()] == ["queued", "cancelled", "queued", "running"]


@pytest.mark.fault("O3")
def test_a_line_torn_by_a_crash_is_never_read_and_is_cut_off_before_the_next(store):
    run_id = store.create(REQUEST, {})
    path = store.folder(run_id) / "events.jsonl"
    whole = path.read_bytes()
    path.write_bytes(whole + b'{"state": "runn')
    read = store.events(run_id)
    assert [event.state for event in read()] == ["queued"]
    assert store.last(run_id).state == "queued"
    store.record(run_id, "running", step=1)
    assert [event.step for event in read()] == [1]
    assert path.read_bytes().count(b"\n") == 2


def test_an_event_has_the_time_when_it_happened_and_one_of_an_earlier_version_has_none(tmp_path):
    times_ns = iter((100, 200))
    store = JobStore(tmp_path, noun="run", clock_ns=lambda: next(times_ns))
    run_id = store.create(REQUEST, {})
    store.record(run_id, "running")
    assert [event.time_ns for event in store.events(run_id)()] == [100, 200]
    (store.folder(run_id) / "events.jsonl").write_text('{"state": "queued", "step": 0, "metrics": {}, "error": ""}\n')
    assert store.last(run_id) == JobEvent(time_ns=0)


def test_processes_append_side_by_side_without_losing_an_event(store, fork_program):
    run_id = store.create(REQUEST, {})
    program = (
        "import sys; from pathlib import Path; from freerein.jobs.store import JobStore\n"
        "for step in range(20): JobStore(Path(sys.argv[1]), noun='run').record(sys.argv[2], 'running', step=step, "
        "metrics={sys.argv[3]: 1.0})"
    )
    root = store.folder(run_id).parent
    writers = [fork_program("tests.code", program, root, run_id, name) for name in "ab"]
    assert [writer.process.wait(300) for writer in writers] == [0, 0]
    events = store.events(run_id)()
    assert len(events) == 41
    assert {name for event in events for name in event.metrics} == {"a", "b"}


def test_artifacts_are_listed_by_name_and_found_only_below_their_folder(store):
    run_id = store.create(REQUEST, {})
    folder = store.folder(run_id) / "artifacts"
    folder.mkdir()
    (folder / "policy.safetensors").write_bytes(b"1234")
    (folder / ".policy.safetensors.tmp").write_bytes(b"12")
    assert [(artifact.name, artifact.size) for artifact in store.artifacts(run_id)] == [("policy.safetensors", 4)]
    assert store.artifact(run_id, "policy.safetensors").read_bytes() == b"1234"
    with pytest.raises(NotFound):
        store.artifact(run_id, "other")
    with pytest.raises(InvalidInput):
        store.artifact(run_id, "../config.json")
    with pytest.raises(InvalidInput):
        store.folder("../../etc")


@pytest.mark.fault("O5")
def test_a_full_disk_tears_no_event(store):
    run_id, whole = store.create(REQUEST, {}), resource.getrlimit(resource.RLIMIT_FSIZE)
    size = (store.folder(run_id) / "events.jsonl").stat().st_size
    resource.setrlimit(resource.RLIMIT_FSIZE, (size + 7, whole[1]))
    try:
        with pytest.raises(OSError, match="large"):
            store.record(run_id, "running")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, whole)
    assert store.last(run_id).state == "queued"
    store.record(run_id, "failed")
    assert [event.state for event in store.events(run_id)()] == ["queued", "failed"]


def test_a_job_whose_request_was_not_recorded_whole_is_not_there(store):
    run_id = store.create(REQUEST, {})
    (store.folder(run_id) / "config.json").unlink()
    assert store.unfinished() == store.page(0, "")[0] == []
    assert store.find(REQUEST) is None
    with pytest.raises(NotFound):
        store.config(run_id)
    assert store.create(REQUEST, {}) == run_id
    assert store.unfinished() == [run_id]


@pytest.mark.parametrize("name", ["request.json", "config.json", "events.jsonl"])
def test_a_job_whose_folder_is_deleted_in_part_is_not_there_and_keeps_no_other_from_being_found(store, name):
    gone, left = store.create(REQUEST, {}), store.create(START, {})
    (store.folder(gone) / name).unlink()
    for call in (store.config, store.fields, store.artifacts, lambda job_id: store.record(job_id, "running")):
        with pytest.raises(NotFound):
            call(gone)
    assert store.find(REQUEST) is None
    assert left in store.unfinished()


def test_a_job_without_events_is_not_unfinished(store):
    run_id = store.create(REQUEST, {})
    (store.folder(run_id) / "events.jsonl").unlink()
    assert store.unfinished() == []
    with pytest.raises(NotFound):
        store.last(run_id)


def test_pages_hold_each_job_once_newest_first_whatever_is_started_meanwhile(store):
    ids = [store.create(START, {}) for _ in range(5)]
    first, token = store.page(2, "")
    store.create(START, {})
    second, token = store.page(2, token)
    third, end = store.page(2, token)
    assert [*first, *second, *third] == ids[::-1]
    assert end == ""


def test_a_page_goes_on_where_the_last_one_ended_though_that_job_is_deleted(store):
    ids = [store.create(START, {}) for _ in range(4)]
    first, token = store.page(2, "")
    assert store.page(2, token) == (ids[1::-1], "")
    for job_id in first:
        store.delete(job_id)
    assert store.page(2, token) == (ids[1::-1], "")


@pytest.mark.fault("F10")
def test_a_page_ends_before_its_reply_is_too_large_and_the_next_one_continues(store):
    large = [store.create(START, {"kind": "ppo", "config": {"bytes": [1] * 120_000}, "steps": 1}) for _ in range(7)]
    huge = store.create(START, {"kind": "ppo", "config": {"bytes": [1] * 400_000}, "steps": 1})
    pages, token = [], ""
    while not pages or token:
        ids, token = store.page(0, token)
        pages.append(ids)
    assert pages == [[huge], [large[6], large[5]], [large[4], large[3]], [large[2], large[1]], [large[0]]]
    replies = [ListRunsResponse(tuple(Run(**store.fields(job_id)) for job_id in ids)) for ids in pages[1:]]
    assert max(wire.pack(reply).ByteSize() for reply in replies) < 8 << 20


@pytest.mark.parametrize(
    ("size", "token", "field"),
    [(1001, "", "page_size"), (0, "0" * 32, "page_token"), (0, "../x", "page_token")],
)
def test_a_page_that_cannot_be_is_refused(store, size, token, field):
    with pytest.raises(InvalidInput) as error:
        store.page(size, token)
    assert error.value.field == field


@pytest.mark.parametrize(
    ("from_step", "max_rows", "steps", "total"),
    [
        (0, 0, list(range(1, 102)), 101),
        (0, 3, [1, 51, 101], 101),
        (52, 2, [52, 101], 50),
        (0, 1, [101], 101),
        (102, 5, [], 0),
    ],
)
def test_metrics_are_whole_or_decimated_evenly_with_the_first_and_the_last(store, from_step, max_rows, steps, total):
    run_id = store.create(REQUEST, {})
    writer = MetricsWriter(store.folder(run_id) / "metrics.jsonl", last_step=0)
    for step in range(1, 102):
        writer.append(step, {"loss": float(step), "broken": math.nan})
    with (store.folder(run_id) / "metrics.jsonl").open("a") as file:
        file.write('{"step": 102')  # being written
    found = store.metrics(JobMetricsRequest(run_id, from_step, max_rows))
    assert [row.step for row in found.rows] == steps
    assert all(row.metrics == {"loss": row.step} for row in found.rows)
    assert (found.total_rows, found.next_step) == (total, 102)


def test_of_many_metrics_the_extremes_of_each_may_be_kept(store):
    run_id = store.create(REQUEST, {})
    path = store.folder(run_id) / "metrics.jsonl"
    spikes = {1234: ("loss", 9.0), 5678: ("return", -7.0)}
    rows = ({"step": step, "loss": math.sin(step), "return": 1.0} for step in range(10_000))
    path.write_text("".join(json.dumps(row | dict([spikes.get(row["step"], ("", 0.0))])) + "\n" for row in rows))
    asked = JobMetricsRequest(run_id, max_rows=50, keep_extremes=True)
    found = store.metrics(asked)
    steps = [row.step for row in found.rows]
    assert (len(steps) <= 50, steps) == (True, sorted(set(steps)))
    assert {0, 1234, 5678, 9999} <= set(steps)
    assert (found.total_rows, found.next_step) == (10_000, 10_000)
    few = store.metrics(replace(asked, max_rows=5))  # no room for two rows of each metric
    assert [row.step for row in few.rows] == [row.step for row in store.metrics(JobMetricsRequest(run_id, 0, 5)).rows]


def test_metrics_of_a_job_that_has_none_are_empty_and_too_many_are_refused(store):
    run_id = store.create(REQUEST, {})
    assert store.metrics(JobMetricsRequest(run_id, from_step=3)) == JobMetrics((), 0, 3)
    with pytest.raises(InvalidInput):
        store.metrics(JobMetricsRequest(run_id, max_rows=10_001))
    with pytest.raises(NotFound):
        store.metrics(JobMetricsRequest("0" * 32))


def test_metrics_of_a_job_that_is_deleted_while_they_are_read_are_not_found(store, monkeypatch):
    run_id = store.create(REQUEST, {})
    MetricsWriter(store.folder(run_id) / "metrics.jsonl", last_step=0).append(1, {"loss": 0.5})
    open_file = Path.open

    def open_deleted(path: Path, *arguments: Any, **options: Any) -> Any:
        shutil.rmtree(store.folder(run_id))
        return open_file(path, *arguments, **options)

    monkeypatch.setattr(Path, "open", open_deleted)
    with pytest.raises(NotFound):
        store.metrics(JobMetricsRequest(run_id))


@pytest.mark.parametrize("length", [10, 1 << 16, 300_000])
def test_lines_of_any_length_are_appended_after_what_a_crash_tore(tmp_path, length):
    path = tmp_path / "lines.jsonl"
    append(path, lambda last: [{"text": "a" * length, "last": last is not None}])
    whole = path.read_bytes()
    path.write_bytes(whole + b"x" * length)
    append(path, lambda last: [{"same": last == json.loads(whole)}])
    assert path.read_bytes() == whole + b'{"same": true}\n'
    assert last_document(path) == {"same": True}


def test_a_file_of_lines_that_is_replaced_is_read_from_its_start(tmp_path):
    path = tmp_path / "metrics.jsonl"
    writer, reader = MetricsWriter(path, last_step=0), LineReader(path)
    for step in (1, 2, 3):
        writer.append(step, {})
    assert [row["step"] for row in reader.read()] == [1, 2, 3]
    MetricsWriter(path, last_step=2).append(3, {"loss": 0.5})
    assert reader.read() == [{"step": 1}, {"step": 2}, {"step": 3, "loss": 0.5}]
    assert reader.read() == []


@pytest.mark.parametrize(("count", "skipped"), [(0, 0), (1, 1), (4, 4), (7, 6), (9, 6)])
def test_lines_of_many_reads_are_passed_over_but_for_the_last(tmp_path, count, skipped):
    path = tmp_path / "lines.jsonl"
    append(path, lambda _: [{"line": line, "text": "a" * 400_000} for line in range(7)])
    reader = LineReader(path)
    assert reader.skip(count) == skipped
    assert reader.read()[0]["line"] == skipped


@pytest.mark.parametrize(
    ("kind", "config", "name"),
    [
        ("ppo", {"task": "blocks.yellow-left-of-green"}, "ppo-yellow-left-of-green"),
        ("ppo", {"task": "../../etc/x"}, "ppo-etc-x"),
        ("evaluate", {"task": "grid", "policy": "random"}, "evaluate-grid"),
        ("collect", {"task": "grid", "dataset": "mine.v2"}, "collect-mine-v2"),
        ("distill", {"dataset": "", "model_name": "words"}, "distill-words"),
        ("pipeline", {"steps": []}, "pipeline"),
        ("segmentation", {"dataset": "x" * 64, "model_name": "default"}, f"segmentation-{'x' * 64}"),
    ],
)
def test_a_job_has_a_readable_name(kind: str, config: dict[str, Any], name: str) -> None:
    assert job_name(kind, config) == name


def test_jobs_are_found_by_readable_names_and_links_of_deleted_ones_go(tmp_path: Path) -> None:
    links = tmp_path / "named"
    runs = JobStore(tmp_path / "runs", noun="run", links=links)
    fits = JobStore(tmp_path / "fits" / "reward", noun="fit", links=links)
    request = {"idempotency_key": "", "kind": "ppo", "config": {}}
    deleted, kept = (runs.create(request, {"kind": "ppo", "config": {"task": f"grid.{name}"}}) for name in "ab")
    shutil.rmtree(runs.folder(deleted))
    fit = fits.create({"idempotency_key": "", "dataset": "mine"}, {"dataset": "mine", "config": {}})
    found = {link.name: link.resolve() for link in links.iterdir()}
    assert found == {f"ppo-b-{kept[:6]}": runs.folder(kept), f"reward-mine-{fit[:6]}": fits.folder(fit)}


def test_a_job_is_made_where_no_link_can_be(tmp_path: Path) -> None:
    (tmp_path / "named").write_text("in the way")
    runs = JobStore(tmp_path / "runs", noun="run", links=tmp_path / "named")
    assert runs.exists(runs.create({"idempotency_key": "a"}, {"kind": "ppo", "config": {}}))
