"""Runs of kind ppo, with the real sim and reward services: what they leave behind, and whatever happens meanwhile."""

import json
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from freerein.errors import FailedPrecondition, InvalidInput, NotFound
from freerein_orchestrator import policy_artifact
from freerein_orchestrator.kinds import KINDS
from freerein_orchestrator.policy_artifact import PolicyActor
from freerein_orchestrator.work import Work

pytestmark = pytest.mark.e2e
TASK = "blocks.red-on-top-of-yellow"
FAST: Mapping[str, Any] = {
    "task": TASK,
    "iterations": 3,
    "num_envs": 2,
    "steps": 16,
    "epochs": 1,
    "batch_size": 16,
    "hidden": 8,
    "features": 8,
}


@pytest.fixture(scope="module")
def services(start_module_service: Callable[..., Any]) -> dict[str, Any]:
    return {
        "sim": start_module_service("freerein_sim", FREEREIN_SIM_WORKERS="1"),
        "reward": start_module_service("freerein_reward"),
    }


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory, services: dict[str, Any]) -> dict[str, Any]:
    """The card of a run in which nothing goes wrong."""
    folder = tmp_path_factory.mktemp("data") / "whole"
    assert run(work_of(folder, services))
    return card(folder)


def work_of(
    folder: Path, services: Mapping[str, Any], *, stop: Callable[[], bool] = lambda: False, **config: Any
) -> Work:
    environ = {f"FREEREIN_{name.upper()}_ADDRESS": service.address for name, service in services.items()}
    whole = KINDS["ppo"].resolve({**FAST, **config})
    return Work(folder, folder.name, whole, folder.parent, "cpu", environ, stop)


def run(work: Work) -> bool:
    with work.closing:
        return KINDS["ppo"].run(work)


def card(folder: Path) -> dict[str, Any]:
    return dict(json.loads((folder / "artifacts" / "policy.json").read_bytes()))


def rows(folder: Path) -> list[dict[str, float]]:
    return [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]


def test_a_run_leaves_a_policy_a_card_and_a_curve(tmp_path: Path, services: dict[str, Any]) -> None:
    assert run(work_of(tmp_path / "run", services))
    told = card(tmp_path / "run")
    assert told["goal_text"] == "a red block on top of a yellow block"
    assert (told["reward"], told["privileged"], told["model"]["name"]) == ("learned", False, "default")
    assert told["figures"]["timesteps"] == 96
    assert [row["step"] for row in rows(tmp_path / "run")] == [1, 2, 3]
    assert {"entropy", "steps_per_s", "recoveries", "rejected", "timesteps"} <= rows(tmp_path / "run")[0].keys()
    policy = policy_artifact.load(tmp_path / "run" / "artifacts", device="cpu")
    frames, starts = np.zeros((2, 64, 64, 3), np.uint8), np.ones(2, np.bool_)
    assert PolicyActor(policy.network).act(frames, starts).shape == (2, 3)
    more = work_of(tmp_path / "more", services, start_from="run", iterations=1)
    KINDS["ppo"].check(more, ())
    KINDS["ppo"].check(work_of(tmp_path / "pipeline", services, start_from="sooner"), ("sooner",))
    with pytest.raises(InvalidInput):
        KINDS["ppo"].check(work_of(tmp_path / "pipeline", services, start_from="sooner"), ())
    assert run(more)
    assert card(tmp_path / "more")["sha256"] != told["sha256"]


def test_a_run_stopped_anywhere_ends_at_the_same_weights(
    tmp_path: Path, services: dict[str, Any], expected: dict[str, Any]
) -> None:
    for calls in (5, 80, 20, 30):
        left = iter(range(calls))

        def stop(left: Iterator[int] = left) -> bool:
            return next(left, None) is None

        assert not run(work_of(tmp_path / "stopped", services, stop=stop))
    assert run(work_of(tmp_path / "stopped", services))
    assert card(tmp_path / "stopped") == expected
    assert [row["step"] for row in rows(tmp_path / "stopped")] == [1, 2, 3]


@pytest.mark.timeout(180)
def test_a_run_whose_process_is_killed_ends_at_the_same_weights(
    tmp_path: Path, services: dict[str, Any], expected: dict[str, Any], new_run: Callable[..., Any]
) -> None:
    killed = new_run(tmp_path, "ppo", FAST, **work_of(tmp_path / "unused", services).environ)
    killed.kill_when((killed.folder / "checkpoints").is_dir)
    killed.kill_when(lambda: len(killed.rows) >= 1)
    assert killed.do()
    assert killed.artifact("policy.json") == expected
    assert [row["step"] for row in killed.rows] == [1, 2, 3]


class Killer:
    """Kills a service at the `count`th call, and starts it again at its address meanwhile."""

    def __init__(self, service: Any, module: str, start: Callable[..., Any], *, count: int) -> None:
        self._service = service
        self._module = module
        self._start = start
        self._left = count
        self._lock = threading.Lock()

    def __call__(self) -> bool:
        with self._lock:
            self._left -= 1
            if self._left == 0:
                self._service.process.send_signal(signal.SIGKILL)
                self._service.process.wait()
                threading.Thread(target=self._again).start()
        return False

    def _again(self) -> None:
        port = self._service.address.rpartition(":")[2]
        self._start(self._module, FREEREIN_GRPC_PORT=port, FREEREIN_SIM_WORKERS="1")


@pytest.mark.timeout(180)
@pytest.mark.parametrize("name", ["sim", "reward"])
def test_a_run_outlives_a_service_that_is_killed_and_ends_at_the_same_weights(
    tmp_path: Path, services: dict[str, Any], expected: dict[str, Any], start_service: Callable[..., Any], name: str
) -> None:
    module = f"freerein_{name}"
    own = {**services, name: start_service(module, FREEREIN_SIM_WORKERS="1")}
    killer = Killer(own[name], module, start_service, count=95)
    assert run(work_of(tmp_path / "killed", own, stop=killer))
    assert card(tmp_path / "killed") == expected
    assert sum(row["recoveries"] for row in rows(tmp_path / "killed")) >= 1


def test_a_run_over_two_sims_goes_on_over_two_only(tmp_path: Path, services: dict[str, Any]) -> None:
    work = work_of(tmp_path / "two", services, iterations=2)
    address = work.environ["FREEREIN_SIM_ADDRESS"]
    both = {**work.environ, "FREEREIN_SIM_ADDRESS": f"{address},{address}"}
    left = iter(range(90))
    assert not run(replace(work, environ=both, stop=lambda: next(left, None) is None, closing=ExitStack()))
    with pytest.raises(FailedPrecondition, match="sims was 2 and is 1"):
        run(replace(work, closing=ExitStack()))
    assert run(replace(work, environ=both, closing=ExitStack()))
    assert card(tmp_path / "two")["sims"] == 2


def test_a_run_uses_no_more_sims_than_it_has_environments(tmp_path: Path, services: dict[str, Any]) -> None:
    work = work_of(tmp_path / "one", services, iterations=1, num_envs=1)
    address = work.environ["FREEREIN_SIM_ADDRESS"]
    assert run(replace(work, environ={**work.environ, "FREEREIN_SIM_ADDRESS": f"{address},{address}"}))
    assert card(tmp_path / "one")["sims"] == 1


@pytest.mark.parametrize(
    ("config", "error"),
    [
        ({"task": "blocks.fly"}, NotFound),
        ({"camera": "below"}, InvalidInput),
        ({"goal_text": "a red block"}, InvalidInput),
        ({"start_from": "nothing"}, InvalidInput),
        ({"reward_model": "nothing"}, FailedPrecondition),
    ],
)
def test_what_cannot_succeed_fails_at_once(
    tmp_path: Path, services: dict[str, Any], config: dict[str, Any], error: type[Exception]
) -> None:
    with pytest.raises(error):
        run(work_of(tmp_path / "run", services, **config))


def test_the_base_reward_is_the_grounding_models_similarity(tmp_path: Path, services: dict[str, Any]) -> None:
    assert run(work_of(tmp_path / "run", services, reward="base", goal_text="a red block", iterations=1))
    assert card(tmp_path / "run")["model"]["name"] == "grounding"
    assert not card(tmp_path / "run")["privileged"]


def test_the_oracles_reward_is_marked_as_privileged(tmp_path: Path, services: dict[str, Any]) -> None:
    assert run(work_of(tmp_path / "run", services, reward="oracle", iterations=1))
    assert card(tmp_path / "run")["privileged"]
    assert card(tmp_path / "run")["supervision"].startswith("the task's true reward")
    assert rows(tmp_path / "run")[0]["privileged"] == 1.0

    assert run(work_of(tmp_path / "more", services, start_from="run", iterations=1))
    assert card(tmp_path / "more")["privileged"]
    assert rows(tmp_path / "more")[0]["privileged"] == 1.0
    assert card(tmp_path / "more")["start"]["sha256"] == card(tmp_path / "run")["sha256"]
    told = card(tmp_path / "more")["supervision"]
    assert told.startswith("goal text; ")
    assert told.endswith(f"supervision: {card(tmp_path / 'run')['supervision']}")
