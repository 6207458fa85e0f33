"""Runs of kind ppo, with the real sim and reward services: what they leave, and that they survive failures."""

import json
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from freerein.cli.__main__ import app
from freerein.clients import Channel, ImitationClient, SyncClient
from freerein.errors import FailedPrecondition, InvalidInput, NotFound
from freerein.learning.actor_critic.policy_files import load_policy
from freerein.types.common import Goal, Image, ModelRef, Observation
from freerein.types.imitation import ActRequest, ActResponse
from freerein_orchestrator.rl.network_policy import NetworkPolicy

pytestmark = pytest.mark.e2e
TASK = "blocks.red-on-top-of-yellow"
FAST: Mapping[str, Any] = {
    "task": TASK,
    "conditions": ["start-on-the-way"],
    "explorations": 1,
    "iterations": 3,
    "num_envs": 2,
    "num_steps": 16,
    "epochs": 1,
    "batch_size": 16,
    "hidden_size": 8,
}


@pytest.fixture(scope="module")
def services(start_module_service: Callable[..., Any]) -> dict[str, Any]:
    return {
        "sim": start_module_service("freerein_sim", FREEREIN_SIM_WORKERS="1"),
        "reward": start_module_service("freerein_reward"),
    }


@pytest.fixture
def ppo(new_run: Callable[..., Any], services: dict[str, Any], tmp_path: Path) -> Callable[..., Any]:
    """A function that makes a run: `ppo("name", services, iterations=1)`."""

    def new(name: str, at: Mapping[str, Any] = services, **config: Any) -> Any:
        environ = {f"FREEREIN_{service.upper()}_ADDRESS": found.address for service, found in at.items()}
        return new_run(tmp_path, "ppo", {**FAST, **config}, name=name, **environ)

    return new


_EXPECTED: list[dict[str, Any]] = []


@pytest.fixture
def expected(ppo: Callable[..., Any]) -> dict[str, Any]:
    """The card of an undisturbed run."""
    if not _EXPECTED:
        run = ppo("undisturbed")
        assert run.do()
        _EXPECTED.append(run.artifact("policy.json"))
    return _EXPECTED[0]


def test_a_run_leaves_a_policy_a_card_and_metrics(ppo: Callable[..., Any]) -> None:
    run = ppo("run")
    assert run.do()
    card = run.artifact("policy.json")
    assert card["goal_text"] == "a red block on top of a yellow block"
    assert (card["reward"], card["privileged"], card["model"]["name"]) == ("learned", False, "default")
    assert card["figures"]["timesteps"] == 2 * (96 + 16)
    assert [row["step"] for row in run.rows] == [1, 2, 3]
    assert {"entropy", "approx_kl", "steps_per_s", "recoveries", "rejected", "timesteps"} <= run.rows[0].keys()
    policy = load_policy(run.folder / "artifacts", device="cpu")
    frames, starts = np.zeros((2, 64, 64, 3), np.uint8), np.ones(2, np.bool_)
    assert NetworkPolicy(policy.network).act(frames, starts).shape == (2, 3)

    more = ppo("more", init_from="run", iterations=1)
    more.check()
    ppo("step", init_from="earlier").check("earlier")
    with pytest.raises(InvalidInput):
        ppo("step", init_from="earlier").check()
    assert more.do()
    assert more.artifact("policy.json")["sha256"] != card["sha256"]


def test_a_run_s_policy_is_published_and_answers(
    ppo: Callable[..., Any], start_service: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = ppo("0" * 32, iterations=1)
    assert run.do()
    service = start_service("freerein_imitation", tmp_path)
    monkeypatch.setenv("FREEREIN_IMITATION_ADDRESS", service.address)
    published = CliRunner().invoke(app, ["models", "publish", "0" * 32, "--name", "stack", "--json"])
    model = json.loads(published.stdout)
    assert (model["ref"]["name"], model["active"], model["card"]["task"]) == ("stack", True, TASK)
    seen = Observation((Image("raw_rgb8", 64, 64, bytes(64 * 64 * 3), "front"),))
    with SyncClient(ImitationClient(Channel(service.address))) as client:
        goal = Goal(text=model["card"]["goal_text"])
        reply: ActResponse = client.act(ActRequest(seen, goal, model=ModelRef("stack")))
    expected = NetworkPolicy(load_policy(run.folder / "artifacts", device="cpu").network)
    black = np.zeros((1, 64, 64, 3), np.uint8)
    np.testing.assert_allclose(reply.actions, expected.act(black, np.ones(1, np.bool_)), atol=1e-5)
    assert reply.in_distribution == 0


class Killer:
    """Kills a service once a run has recorded a row, and starts it again at its address once the run waits for it."""

    def __init__(self, service: Any, module: str, start: Callable[..., Any], run: Any) -> None:
        self._service = service
        self._module = module
        self._start = start
        self._run = run
        self._is_killed = self._is_restarted = False
        self._lock = threading.Lock()

    def __call__(self) -> bool:
        with self._lock:
            if not self._is_killed and self._run.rows:
                self._is_killed = True
                self._service.kill()
                self._service.process.wait()
            elif self._is_killed and not self._is_restarted and self._run.waiting:
                self._is_restarted = True
                port = self._service.address.rpartition(":")[2]
                self._start(self._module, FREEREIN_GRPC_PORT=port, FREEREIN_SIM_WORKERS="1")
        return False


@pytest.mark.parametrize("name", ["sim", "reward"])
def test_a_run_outlives_a_service_that_is_killed_and_ends_with_the_same_weights(
    ppo: Callable[..., Any],
    services: dict[str, Any],
    expected: dict[str, Any],
    start_service: Callable[..., Any],
    name: str,
) -> None:
    module = f"freerein_{name}"
    own = {**services, name: start_service(module, FREEREIN_SIM_WORKERS="1")}
    run = ppo("killed", own)
    assert run.do(stop=Killer(own[name], module, start_service, run))
    assert run.artifact("policy.json") == expected
    assert sum(row["recoveries"] for row in run.rows) >= 1


def test_a_run_over_two_sims_resumes_over_two_only(ppo: Callable[..., Any], services: dict[str, Any]) -> None:
    run, one = ppo("two", iterations=2), services["sim"].address
    run.environ["FREEREIN_SIM_ADDRESS"] = f"{one},{one}"
    assert not run.do(stop=lambda: bool(run.rows))
    run.environ["FREEREIN_SIM_ADDRESS"] = one
    with pytest.raises(FailedPrecondition, match="sims was 2 and is 1"):
        run.do()
    run.environ["FREEREIN_SIM_ADDRESS"] = f"{one},{one}"
    assert run.do()
    assert run.artifact("policy.json")["sims"] == 2

    single = ppo("one", iterations=1, num_envs=1)
    single.environ["FREEREIN_SIM_ADDRESS"] = f"{one},{one}"
    assert single.do()
    assert single.artifact("policy.json")["sims"] == 1


@pytest.mark.parametrize(
    ("config", "error"),
    [
        ({"task": "blocks.fly"}, NotFound),
        ({"camera": "below"}, InvalidInput),
        ({"goal_text": "a red block"}, InvalidInput),
        ({"goal_text": "a crimson block on top of a yellow block"}, InvalidInput),
        ({"init_from": "nothing"}, InvalidInput),
        ({"reward_model": "nothing"}, FailedPrecondition),
    ],
)
def test_a_run_that_cannot_succeed_fails_at_once(
    ppo: Callable[..., Any], config: dict[str, Any], error: type[Exception]
) -> None:
    with pytest.raises(error):
        ppo("run", **config).do()


def test_the_base_reward_is_the_grounding_models_similarity(ppo: Callable[..., Any]) -> None:
    run = ppo("run", reward="base", goal_text="a red block", encoder="spatial", iterations=1)
    assert run.do()
    assert run.artifact("policy.json")["model"]["name"] == "grounding"
    assert not run.artifact("policy.json")["privileged"]


def test_the_eye_for_the_base_reward_is_the_reward_models_whichever_grounding_model_rewards(
    ppo: Callable[..., Any],
) -> None:
    run = ppo("run", reward="base", reward_model="grounding", iterations=1)
    assert run.do()
    card = run.artifact("policy.json")
    assert (card["model"]["name"], card["eye"]["name"]) == ("grounding", "default")


def test_the_oracles_reward_marks_a_policy_and_those_initialised_from_it_as_privileged(ppo: Callable[..., Any]) -> None:
    run, more = ppo("run", reward="oracle", iterations=1), ppo("more", init_from="run", iterations=1)
    assert run.do()
    assert more.do()
    first, second = run.artifact("policy.json"), more.artifact("policy.json")
    assert first["privileged"]
    assert second["privileged"]
    assert run.rows[0]["privileged"] == more.rows[0]["privileged"] == 1.0
    assert first["supervision"].startswith("the task's true reward")
    assert second["init"]["sha256"] == first["sha256"]
    assert second["supervision"].startswith("goal text; ")
    assert second["supervision"].endswith(f"supervision: {first['supervision']}")
