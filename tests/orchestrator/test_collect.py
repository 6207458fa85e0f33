"""Runs of kind `collect`, with the real sim service."""

import json
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from freerein.clients import Channel, SimClient, SyncClient
from freerein.data import Dataset, dataset_path, read_teachers
from freerein.data.dataset_recorder import DatasetRecorder, recording
from freerein.errors import FailedPrecondition, InvalidInput, NotFound
from freerein.learning.actor_critic.networks import ActorCriticSpec
from freerein.learning.actor_critic.policy_files import save_policy
from freerein.types.common import ActionSpec, Camera
from freerein.types.sim import DemonstrateRequest, ListTasksRequest, Task
from freerein_orchestrator.kinds import KINDS
from freerein_orchestrator.kinds.collect.mix import _spec, parts_of_rounds
from freerein_orchestrator.rl.initial_network import init_network

pytestmark = pytest.mark.e2e
COLLECT = KINDS["collect"]
EXPERT = {"task": "grid", "dataset": "demos", "count": 3, "max_skills": 2, "seed": 3}
RANDOM = {"task": "grid", "dataset": "demos", "behaviour": "random", "count": 4}
VARIED = RANDOM | {"count": 2, "conditions": ["warm", "blur"]}
CURIOSITY = {
    "task": "grid",
    "dataset": "demos",
    "behaviour": "curiosity",
    "count": 8,
    "num_envs": 2,
    "length": 20,
}


@pytest.fixture
def collect(new_run: Callable[..., Any], mortal_sim: Any, tmp_path: Path) -> Callable[..., Any]:
    """A function that makes a run of a configuration."""

    def new(config: dict[str, Any], *, name: str = "run", address: str = mortal_sim.address) -> Any:
        return new_run(tmp_path, "collect", config, name=name, FREEREIN_SIM_ADDRESS=address)

    return new


def recorded(root: Path, sim: Any, request: DemonstrateRequest) -> str:
    """Returns the fingerprint of a dataset recorded without a run, and without disturbance."""
    with SyncClient(SimClient(Channel(sim.address))) as client:
        recording = DatasetRecorder(root, request, client.list_tasks(ListTasksRequest()))
        with recording, closing(client.demonstrate(recording.remaining)) as demonstrations:
            for demonstration in demonstrations:
                recording.append(demonstration)
    return Dataset(root).fingerprint


@pytest.mark.parametrize("config", [EXPERT, RANDOM, VARIED], ids=["expert", "random", "varied"])
def test_a_run_records_what_the_same_request_does_and_describes_it(
    collect: Callable[..., Any], mortal_sim: Any, tmp_path: Path, config: dict[str, Any]
) -> None:
    run = collect(config)
    assert run.do()

    request = {"behaviour": "expert", **config, "conditions": tuple(config.get("conditions", ()))}
    del request["dataset"]
    fingerprint = recorded(tmp_path / "plain", mortal_sim, DemonstrateRequest(**request))
    dataset = Dataset(dataset_path(tmp_path, "demos"))
    assert dataset.fingerprint == fingerprint
    assert [bool(each.terminated[-1]) for each in dataset] == [config is EXPERT] * len(dataset)
    assert run.artifact("dataset.json") == {
        "dataset": "demos",
        "task": "grid",
        "conditions": sorted(config.get("conditions", [])),
        "trajectories": config["count"],
        "timesteps": dataset.lengths.sum(),
        "fingerprint": fingerprint,
    }
    assert run.rows[-1] == {"step": config["count"], "timesteps": dataset.lengths.sum()}


def test_a_stopped_run_continues_and_records_nothing_twice(
    collect: Callable[..., Any], mortal_sim: Any, tmp_path: Path
) -> None:
    run, asked = collect(RANDOM), list[None]()

    def stop_after_two() -> bool:
        asked.append(None)
        return len(asked) > 3  # it is asked before and after the list of tasks, too

    assert not run.do(stop=stop_after_two)
    assert 0 < len(Dataset(dataset_path(tmp_path, "demos"))) < 4
    assert run.do()

    fingerprint = recorded(tmp_path / "plain", mortal_sim, DemonstrateRequest("grid", "random", count=4))
    assert Dataset(dataset_path(tmp_path, "demos")).fingerprint == fingerprint
    steps = [row["step"] for row in run.rows]
    assert steps == sorted(set(steps))


@pytest.mark.parametrize(
    ("config", "killed_at", "replaced_at"),
    [
        pytest.param(EXPERT | {"count": 60}, 3, 5, id="expert"),
        pytest.param(CURIOSITY, 2, 5, id="curiosity", marks=pytest.mark.long),
    ],
)
def test_a_child_killed_and_a_sim_killed_leave_the_dataset_of_an_undisturbed_run(
    collect: Callable[..., Any],
    mortal_sim: Any,
    tmp_path: Path,
    config: dict[str, Any],
    killed_at: int,
    replaced_at: int,
) -> None:
    root, replacing = dataset_path(tmp_path, "demos"), mortal_sim.replaced_at(replaced_at)
    run = collect(config)
    run.kill_when((root / "data/chunk-000" / f"file-{killed_at:03d}.parquet").exists)
    assert len(Dataset(root)) < config["count"]
    assert run.do(stop=replacing)
    assert replacing.is_done
    undisturbed = collect(config | {"dataset": "plain"}, name="plain")
    assert undisturbed.do()
    assert Dataset(root).fingerprint == Dataset(dataset_path(tmp_path, "plain")).fingerprint
    if config is CURIOSITY:
        check_curiosity(undisturbed, Dataset(root))


@pytest.fixture
def walkers(collect: Callable[..., Any], tmp_path: Path) -> list[dict[str, Any]]:
    """Parts of a mix: a policy that was never trained, greedy and sampled under conditions, and random actions."""
    spec = ActorCriticSpec(action_choices=5, height=33, width=30, hidden_size=4, feature_size=8)
    card = {"camera": "top", "reward": "oracle", "supervision": "all", "privileged": True, "figures": {"timesteps": 64}}
    network = init_network(spec, torch.Generator().manual_seed(0))
    network.calibrate(torch.zeros(2, 33, 30, 3, dtype=torch.uint8))
    save_policy(network, tmp_path / "runs" / "walker" / "artifacts", card=card)
    sampled = {"policy": "walker", "share": 25, "stochastic": True, "conditions": ["warm"]}
    return [{"policy": "walker", "share": 40}, sampled, {"share": 35, "task": "grid-no-indicator"}]


def test_a_mix_has_its_parts_in_shares_and_says_what_their_policies_learned_from(
    collect: Callable[..., Any], walkers: list[dict[str, Any]], tmp_path: Path
) -> None:
    config = {"task": "grid", "dataset": "mix", "behaviour": "mix", "count": 39, "num_envs": 2, "parts": walkers}
    run = collect(config)
    run.check()
    assert run.do()

    card = run.artifact("dataset.json")
    shares = [each["timesteps"] / card["timesteps"] for each in card["parts"]]
    assert shares == pytest.approx([0.4, 0.25, 0.35], abs=0.06)
    assert [each["learned_timesteps"] for each in card["parts"]] == [64, 64, 0]
    assert [each["conditions"] for each in card["parts"]] == [[], ["warm"], []]
    assert [each["task"] for each in card["parts"]] == ["", "", "grid-no-indicator"]
    own = {
        name: card["parts"][0][name] for name in ("sha256", "reward", "supervision", "privileged", "learned_timesteps")
    }
    assert read_teachers(dataset_path(tmp_path, "mix")) == [{"task": "grid", **own}] * 2
    assert own["privileged"] is True
    dataset = Dataset(dataset_path(tmp_path, "mix"))
    parts = np.repeat(parts_of_rounds(run.config, dataset.lengths.tolist()), 2)[: len(dataset)]
    chosen = [{int(a) for i in np.flatnonzero(parts == part) for a in dataset.actions(i)[:, 0]} for part in range(3)]
    assert len(chosen[0]) < len(chosen[1]) == len(chosen[2]) == 5  # the untrained one has favourites

    again = collect(config | {"dataset": "again", "count": 30}, name="again")
    stops = iter([False] * 300 + [True] * 1000)
    assert not again.do(stop=lambda: next(stops))
    root = dataset_path(tmp_path, "again")
    assert 0 < len(Dataset(root)) < 30
    request = json.loads((root / "recording.json").read_text())
    (root / "recording.json").write_text(json.dumps(request | {"count": 30}))  # as earlier versions wrote it
    assert collect(config | {"dataset": "again"}, name="larger").do()
    assert Dataset(root).fingerprint == dataset.fingerprint


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"parts": []}, "has at least one; got 0"),
        ({"behaviour": "random"}, "got 3 of random"),
        ({"parts": [{"policy": "nobody"}]}, "must exist"),
        ({"height": 20, "width": 20}, "it sees 33 x 30, and those are 20 x 20"),
        ({"task": "pendulum", "parts": [{"policy": "walker"}]}, "same cameras and actions"),
        ({"parts": [{"share": 1}, {"task": "pendulum"}]}, "`pendulum` has others than grid"),
    ],
)
def test_a_mix_that_cannot_be_recorded_is_refused(
    collect: Callable[..., Any], walkers: list[dict[str, Any]], change: dict[str, Any], match: str
) -> None:
    config = {"task": "grid", "dataset": "mix", "behaviour": "mix", "count": 2, "parts": walkers}

    def record() -> None:
        run = collect(config | change)
        run.check()
        run.do()

    with pytest.raises(InvalidInput, match=match):
        record()


def test_a_mix_of_cameras_of_different_sizes_needs_one_size() -> None:
    cameras = Camera("top", 33, 30, 3), Camera("side", 64, 64, 3)
    task = Task("grid", "grid", "", cameras, ActionSpec(1, 5, tuple("abcde")), 0.1, (), 50)
    mix = COLLECT.parse(
        {"task": "grid", "dataset": "mix", "behaviour": "mix", "parts": [{}], "cameras": ["top", "side"]}
    )
    with pytest.raises(InvalidInput, match="must have frames of one size; got 33 x 30 and 64 x 64") as refused:
        _spec({"grid": task}, mix)
    assert refused.value.hint == "Set `height` and `width`."
    _spec({"grid": task}, replace(mix, height=20, width=20))


def check_curiosity(run: Any, dataset: Dataset) -> None:
    """Checks that all it did is recorded, as trajectories within episodes."""
    assert len(dataset) == CURIOSITY["count"]
    assert dataset.lengths.tolist() == [20] * 4 + [10] * 4  # an episode has 50
    assert dataset.skills == ((),) * len(dataset)
    assert not any(each.terminated.any() for each in dataset)  # a time limit does not terminate an episode
    assert [row["step"] for row in run.rows] == [2, 4, 8]
    assert all(row["intrinsic_reward"] > 0 for row in run.rows)


def test_a_run_told_to_stop_while_its_sim_is_unavailable_stops(collect: Callable[..., Any]) -> None:
    asked: list[None] = []

    def stop_when_asked_again() -> bool:
        asked.append(None)
        return len(asked) > 3

    assert not collect(EXPERT, address="127.0.0.1:9").do(stop=stop_when_asked_again)


def test_an_invalid_recording_is_refused(collect: Callable[..., Any], tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="Only the expert"):
        COLLECT.parse(RANDOM | {"max_skills": 1})
    with pytest.raises(InvalidInput, match="one camera"):
        COLLECT.parse(CURIOSITY | {"cameras": ["top", "side"]})
    with pytest.raises(InvalidInput):
        COLLECT.parse(RANDOM | {"dataset": "../demos"})
    with pytest.raises(InvalidInput, match="must be at most 100000 where the behaviour is scripted; got 100001"):
        COLLECT.parse(RANDOM | {"count": 100_001})
    with pytest.raises(NotFound):
        collect(RANDOM | {"task": "nothing"}).do()
    assert collect(RANDOM, name="first").do()
    with pytest.raises(FailedPrecondition, match="another"):
        collect(RANDOM | {"seed": 1}, name="second").do()
    root = dataset_path(tmp_path, "demos")
    for request, is_free in (({"seed": 1}, True), ({"seed": 1, "count": 5}, False)):
        with pytest.raises(FailedPrecondition) as refused, recording(root, Dataset(root).spec, request):
            pass
        assert ("with a larger count" in refused.value.hint) == is_free
