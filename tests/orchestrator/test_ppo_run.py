"""Runs of kind ppo, with the real sim and reward services: what they leave, and that they survive failures."""

import json
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from typer.testing import CliRunner

from freerein.cli.__main__ import app
from freerein.clients import Channel, ImitationClient, SyncClient
from freerein.errors import FailedPrecondition, InvalidInput, NotFound
from freerein.learning import checkpoints
from freerein.learning.actor_critic.policy_files import load_policy
from freerein.types.common import Goal, Image, ModelRef, Observation
from freerein.types.imitation import ActRequest, ActResponse
from freerein.video.reader import open_video
from freerein_orchestrator.rl.network_policy import NetworkPolicy

pytestmark = pytest.mark.e2e
TASK = "blocks.red-on-top-of-yellow"
FAST: Mapping[str, Any] = {
    "task": TASK,
    "conditions": ["start-on-the-way"],
    "explorations": 1,
    "iterations": 2,
    "num_envs": 2,
    "num_steps": 8,
    "epochs": 1,
    "batch_size": 8,
    "hidden_size": 8,
}
GRID = {"task": "grid", "conditions": [], "encoder": "spatial"}
RUN_ID = "0" * 32


@pytest.fixture(scope="module")
def services(mortal: Callable[..., Any], mortal_sim: Any) -> dict[str, Any]:
    return {"sim": mortal_sim, "reward": mortal("freerein_reward")}


@pytest.fixture(scope="module")
def data_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("data")


@pytest.fixture(scope="module")
def ppo(new_run: Callable[..., Any], services: dict[str, Any], data_dir: Path) -> Callable[..., Any]:
    """A function that makes a run: `ppo(iterations=1)`."""
    environ = {f"FREEREIN_{name.upper()}_ADDRESS": service.address for name, service in services.items()}
    return lambda name="", **config: new_run(data_dir, "ppo", {**FAST, **config}, name=name, **environ)


@pytest.fixture(scope="module")
def trained(ppo: Callable[..., Any]) -> Any:
    """A run that nothing disturbed."""
    run = ppo(RUN_ID)
    assert run.do()
    return run


def test_a_run_leaves_a_policy_a_card_and_metrics(ppo: Callable[..., Any], trained: Any) -> None:
    card = trained.artifact("policy.json")
    assert card["goal_text"] == "a red block on top of a yellow block"
    assert (card["reward"], card["privileged"], card["model"]["name"]) == ("learned", False, "default")
    assert card["supervision"].endswith("; the simulator arranged episodes of training: start-on-the-way")
    assert card["figures"]["timesteps"] == 2 * (32 + 16)
    assert [row["step"] for row in trained.rows] == [1, 2]
    with open_video(trained.folder / "artifacts" / "policy.mp4") as video:
        assert (sum(1 for _ in video), video.info.height) == (2 * 8, 256)
    assert {"entropy", "approx_kl", "steps_per_s", "recoveries", "rejected", "timesteps"} <= trained.rows[0].keys()
    policy = load_policy(trained.folder / "artifacts", device="cpu")
    frames, starts = np.zeros((2, 64, 64, 3), np.uint8), np.ones(2, np.bool_)
    assert NetworkPolicy(policy.network).act(frames, starts).shape == (2, 3)

    more = ppo(init_from=RUN_ID, iterations=1)
    more.check()
    ppo(init_from="earlier").check(earlier="ppo")
    with pytest.raises(InvalidInput):
        ppo(init_from="earlier").check()
    assert more.do()
    assert more.artifact("policy.json")["sha256"] != card["sha256"]


def test_a_run_goes_on_with_the_training_of_another(ppo: Callable[..., Any], trained: Any) -> None:
    more = ppo(resume_from=RUN_ID, iterations=1, lr=1e-4)
    more.check()
    ppo(resume_from="earlier").check(earlier="ppo")
    assert more.do()
    figures = [run.artifact("policy.json")["figures"] for run in (trained, more)]
    assert [each["iterations"] for each in figures] == [2, 3]
    assert [each["timesteps"] for each in figures] == [96, 128]


def test_a_step_of_a_pipeline_goes_on_with_an_earlier_one(
    new_run: Callable[..., Any], services: dict[str, Any], tmp_path: Path
) -> None:
    own = {**FAST, **GRID, "reward": "oracle", "iterations": 1}
    steps = [
        {"name": "first", "kind": "ppo", "config": own},
        {"name": "more", "kind": "ppo", "config": own | {"resume_from": "first", "iterations": 2}},
    ]
    run = new_run(tmp_path, "pipeline", {"steps": steps}, FREEREIN_SIM_ADDRESS=services["sim"].address)
    run.check()
    assert run.do()
    assert run.artifact("more.policy.json")["figures"]["iterations"] == 3
    assert run.artifact("more.policy.json")["privileged"]
    shown = [EventAccumulator(str(run.folder / "tensorboard" / step)).Reload() for step in ("first", "more")]
    assert [[each.step for each in curve.Scalars("train/lr")] for curve in shown] == [[32], [64, 96]]


@pytest.mark.parametrize(
    ("config", "field"),
    [
        ({"resume_from": RUN_ID, "num_envs": 4}, "config.num_envs"),
        ({"resume_from": RUN_ID, "final_log_std": None}, "config.final_log_std"),
        ({"resume_from": RUN_ID, "conditions": []}, "config.conditions"),
        ({"resume_from": "1" * 32}, "config.resume_from"),
        ({"resume_from": "nothing"}, "config.resume_from"),
    ],
)
def test_a_run_that_cannot_go_on_with_another_is_refused_before_it_is_queued(
    ppo: Callable[..., Any], trained: Any, config: dict[str, Any], field: str
) -> None:
    assert trained
    with pytest.raises(InvalidInput) as raised:
        ppo(**config).check()
    assert raised.value.field == field


def test_weights_alone_or_the_whole_training_but_not_both(ppo: Callable[..., Any]) -> None:
    with pytest.raises(InvalidInput, match="got both"):
        ppo(resume_from=RUN_ID, init_from=RUN_ID)


def test_a_run_s_policy_is_published_and_answers(
    trained: Any, start_service: Callable[..., Any], data_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    service = start_service("freerein_imitation", data_dir)
    monkeypatch.setenv("FREEREIN_IMITATION_ADDRESS", service.address)
    published = CliRunner().invoke(app, ["models", "publish", RUN_ID, "--name", "stack", "--json"])
    model = json.loads(published.stdout)
    assert (model["ref"]["name"], model["active"], model["card"]["task"]) == ("stack", True, TASK)
    seen = Observation((Image("raw_rgb8", 64, 64, bytes(64 * 64 * 3), "front"),))
    with SyncClient(ImitationClient(Channel(service.address))) as client:
        goal = Goal(text=model["card"]["goal_text"])
        reply: ActResponse = client.act(ActRequest(seen, goal, model=ModelRef("stack")))
    expected = NetworkPolicy(load_policy(trained.folder / "artifacts", device="cpu").network)
    black = np.zeros((1, 64, 64, 3), np.uint8)
    np.testing.assert_allclose(reply.actions, expected.act(black, np.ones(1, np.bool_)), atol=1e-5)
    assert reply.in_distribution < 1e-5


class Killer:
    """Kills a service once a run has recorded a row, and starts it again at its address once the run waits for it."""

    def __init__(self, service: Any, run: Any) -> None:
        self._service = service
        self._run = run
        self._is_killed = self._is_restarted = False
        self._lock = threading.Lock()

    def __call__(self) -> bool:
        with self._lock:
            if not self._is_killed and self._run.rows:
                self._is_killed = True
                self._service.kill()
            elif self._is_killed and not self._is_restarted and self._run.waiting:
                self._is_restarted = True
                self._service.restart()
        return False


def test_a_run_outlives_a_reward_service_that_is_killed_and_ends_with_the_same_weights(
    ppo: Callable[..., Any], services: dict[str, Any], trained: Any
) -> None:
    run = ppo()
    assert run.do(stop=Killer(services["reward"], run))
    assert run.artifact("policy.json") == trained.artifact("policy.json")
    assert sum(row["recoveries"] for row in run.rows) >= 1


def test_a_run_of_stacked_frames_killed_and_its_sim_killed_ends_with_the_same_weights(
    ppo: Callable[..., Any], services: dict[str, Any]
) -> None:
    seen = {"cameras": ["left", "tilt"], "reward_cameras": ["front"], "frame_stack": 3, "gray": True, "width": 48}
    config = {"encoder": "spatial", "iterations": 3, "height": 48, **seen}
    undisturbed, killed = ppo(**config), ppo(**config)
    assert undisturbed.do()
    killed.kill_when(lambda: bool(killed.rows))
    assert killed.do(stop=Killer(services["sim"], killed))
    card = undisturbed.artifact("policy.json")
    assert killed.artifact("policy.json") == card
    assert sum(row["recoveries"] for row in killed.rows) >= 1
    assert (card["cameras"], [each["name"] for each in card["reward_cameras"]]) == (["left", "tilt"], ["front"])
    network = load_policy(undisturbed.folder / "artifacts", device="cpu").network
    assert network.spec.observation_shape == (48, 48, 6)


def test_a_run_that_practises_keeps_the_states_that_episodes_begin_in(ppo: Callable[..., Any]) -> None:
    run = ppo(task="blocks.red-left-of-yellow", practice_share=1.0, num_steps=16, iterations=3)
    assert run.do()
    card = run.artifact("policy.json")
    assert card["supervision"].endswith("; episodes of training began in states that earlier ones had visited")
    saved = checkpoints.newest(run.folder / "checkpoints", on_corrupt=lambda *_: None)
    assert saved is not None
    memories = [saved.tensors[f"collector/env/{index}"].numpy().tobytes() for index in (1, 3)]  # each after its sim's
    assert any(json.loads(each[8 : 8 + int.from_bytes(each[:8])])["starts"] for each in memories)


def test_a_run_over_two_sims_resumes_over_two_only(ppo: Callable[..., Any], services: dict[str, Any]) -> None:
    run, one = ppo(**GRID, reward="oracle"), services["sim"].address
    run.environ["FREEREIN_SIM_ADDRESS"] = f"{one},{one}"
    assert not run.do(stop=lambda: bool(run.rows))
    run.environ["FREEREIN_SIM_ADDRESS"] = one
    with pytest.raises(FailedPrecondition, match="sims was 2 and is 1"):
        run.do()
    run.environ["FREEREIN_SIM_ADDRESS"] = f"{one},{one}"
    assert run.do()
    assert run.artifact("policy.json")["sims"] == 2

    single = ppo(**GRID, reward="oracle", iterations=1, num_envs=1)
    single.environ["FREEREIN_SIM_ADDRESS"] = f"{one},{one}"
    assert single.do()
    assert single.artifact("policy.json")["sims"] == 1


@pytest.mark.parametrize(
    ("config", "error"),
    [
        ({"task": "blocks.fly"}, NotFound),
        ({"task": "blocks", "reward": "oracle", "encoder": "spatial"}, InvalidInput),
        ({"camera": "below"}, InvalidInput),
        ({"cameras": ["front", "below"], "encoder": "spatial"}, InvalidInput),
        ({"reward_cameras": ["below"]}, InvalidInput),
        ({"reward_cameras": ["left"]}, InvalidInput),
        ({"frame_stack": 8, "encoder": "spatial"}, InvalidInput),
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
        ppo(**config).do()


def test_the_base_reward_is_the_grounding_models_similarity_and_the_object_encoder_the_reward_models(
    ppo: Callable[..., Any],
) -> None:
    run = ppo(reward="base", reward_model="grounding", iterations=1)
    assert run.do()
    card = run.artifact("policy.json")
    assert (card["model"]["name"], card["eye"]["name"], card["privileged"]) == ("grounding", "default", False)


def test_curiosity_learns_while_the_policy_does(ppo: Callable[..., Any]) -> None:
    run = ppo(**GRID | {"encoder": "convolutional"}, recurrent=True, reward="curiosity", iterations=1)
    assert run.do()
    assert load_policy(run.folder / "artifacts", device="cpu").network.spec.encoder == run.config.encoder
    assert run.rows[0]["intrinsic_reward"] > 0
    assert run.artifact("policy.json")["supervision"] == "none"


def test_the_oracles_reward_marks_a_policy_and_those_initialised_from_it_as_privileged(ppo: Callable[..., Any]) -> None:
    run = ppo("oracle", reward="oracle", encoder="spatial", iterations=1)
    more = ppo(init_from="oracle", encoder="spatial", iterations=1)
    assert run.do()
    assert more.do()
    first, second = run.artifact("policy.json"), more.artifact("policy.json")
    assert first["privileged"]
    assert second["privileged"]
    assert run.rows[0]["privileged"] == more.rows[0]["privileged"] == 1.0
    assert first["supervision"].startswith(
        "the task's true reward, which is privileged: to compare with; the simulator"
    )
    assert second["init"]["sha256"] == first["sha256"]
    assert second["supervision"].startswith("goal text; ")
    assert second["supervision"].endswith(f"supervision: {first['supervision']}")
