"""Runs of kind `distill`, with the real sim and imitation services, and untrained teachers."""

import errno
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from freerein.atomic_files import write_atomic
from freerein.clients import Channel, RewardClient, SyncClient
from freerein.data import Dataset, dataset_path, reached
from freerein.errors import AlreadyExists, InvalidInput, NotFound
from freerein.learning.actor_critic.networks import ActorCriticSpec
from freerein.learning.actor_critic.policy_files import StoredPolicy, load_policy, save_policy
from freerein.learning.actor_critic.shared_object_encoder import load_object_encoder
from freerein.model_store import CLONE_MODELS, ModelStore
from freerein.types.common import Camera, ModelRef
from freerein.types.reward import RewardRequest
from freerein_orchestrator.envs.episodes import Episode
from freerein_orchestrator.kinds import KINDS
from freerein_orchestrator.kinds.distill import _updates_before
from freerein_orchestrator.kinds.distill.rollouts import relabelled
from freerein_orchestrator.rl.initial_network import init_network
from freerein_orchestrator.rl.object_encoder import load_reward_encoder

pytestmark = pytest.mark.e2e
SPEC = ActorCriticSpec(height=33, width=30, channels=3, action_choices=5, feature_size=8, hidden_size=8)
TEACHERS = {"a" * 32: "pick up all", "b" * 32: "pick up nothing"}
TINY = {"steps": 6, "batch_size": 2, "features": 8, "text_features": 4, "hidden_size": 8, "log_every": 2}
DISTILL = {"teachers": list(TEACHERS), "rollouts": 2, "num_envs": 2, "dataset": "rollouts", "config": TINY}
TWICE = {"dagger_iterations": 1}
NOWHERE = "127.0.0.1:9"
"""Where no service listens."""


@pytest.fixture(scope="module")
def sim(start_module_service: Callable[..., Any]) -> str:
    return str(start_module_service("freerein_sim", FREEREIN_SIM_WORKERS="1").address)


def teach(data_dir: Path, run_id: str, *, spec: ActorCriticSpec = SPEC, **card: Any) -> None:
    generator = torch.Generator().manual_seed(int(run_id[:4], 16))
    network = init_network(spec, generator)
    network.calibrate(torch.randint(256, (8, *spec.observation_shape), dtype=torch.uint8, generator=generator))
    told = {"task": "grid", "camera": "top", "goal_text": TEACHERS.get(run_id, ""), **card}
    save_policy(network, data_dir / "runs" / run_id / "artifacts", card=told)


@pytest.fixture
def data_dir(tmp_path: Path) -> Path:
    """A data directory with the teachers' runs."""
    for run_id in TEACHERS:
        teach(tmp_path, run_id, supervision="what is true", privileged=True)
    return tmp_path


@pytest.fixture
def distillation(new_run: Callable[..., Any], data_dir: Path, sim: str) -> Callable[..., Any]:
    """A function that makes a run of a configuration."""

    def new(*, imitation: str = NOWHERE, reward: str = NOWHERE, **changes: Any) -> Any:
        addresses = {"sim": sim, "imitation": imitation, "reward": reward}
        environ = {f"FREEREIN_{service.upper()}_ADDRESS": address for service, address in addresses.items()}
        return new_run(data_dir, "distill", DISTILL | changes, **environ)

    return new


@pytest.mark.long  # two fits of language policies
@pytest.mark.fault("O1")
def test_a_run_killed_during_rollouts_and_during_its_fits_comes_to_the_same_dataset_and_fits_each_student_once(
    distillation: Callable[..., Any], start_service: Callable[..., Any], data_dir: Path
) -> None:
    """Of the same dataset a fit makes the same student, which takes seconds."""
    address = start_service("freerein_imitation", data_dir, FREEREIN_SHIPPED_DIR="none").address
    killed, fits = distillation(imitation=address, **TWICE), data_dir / "fits"

    def trajectories(run: Any) -> int:
        return len(list((run.folder / "rollouts" / "data").rglob("*.parquet")))

    killed.kill_when(lambda: trajectories(killed) >= 3)
    killed.kill_when(lambda: any(fits.rglob("request.json")))
    assert not killed.do(stop=(killed.folder / "parts" / "fit-0" / "model.json").is_file)
    undisturbed = distillation(imitation=address, dataset="undisturbed", **TWICE)
    shutil.copytree(killed.folder, undisturbed.folder, ignore=shutil.ignore_patterns("config.json"), dirs_exist_ok=True)
    assert not undisturbed.do(stop=(undisturbed.folder / "artifacts" / "dataset.json").exists)
    killed.kill_when(lambda: trajectories(killed) >= 7)
    killed.kill_when(lambda: len(list(fits.rglob("request.json"))) >= 2)
    assert killed.do()

    teachers = distillation(dataset="teachers")
    assert not teachers.do(stop=(teachers.folder / "artifacts" / "dataset.json").exists)  # and no fit
    assert Dataset(dataset_path(data_dir, "rollouts.0")).fingerprint == teachers.artifact("dataset.json")["fingerprint"]
    card_of_dataset = killed.artifact("dataset.json")
    assert card_of_dataset == undisturbed.artifact("dataset.json") | {"dataset": "rollouts"}
    assert len(list(fits.rglob("request.json"))) == 2

    dataset = Dataset(dataset_path(data_dir, "rollouts"))
    assert dataset.goal_texts == (*["pick up all"] * 2, *["pick up nothing"] * 2) * 2
    assert dataset.spec.action.names == ("up", "down", "left", "right", "pick-up")
    assert [each.terminated.any() for each in dataset] == [len(each.actions) < 50 for each in dataset]
    assert [teacher["goal_text"] for teacher in card_of_dataset["teachers"]] == ["pick up all", "pick up nothing"]
    assert killed.model.name == "language"
    card = json.loads((data_dir / "models/imitation/language" / killed.model.version / "card.json").read_bytes())
    assert card["privileged"]
    assert card["supervision"].endswith("of policies with this supervision: what is true")
    steps = [row["step"] for row in killed.rows]
    assert (steps == sorted(set(steps)), steps[:2], steps[-1]) == (True, [2, 4], killed.kind.steps(killed.config))
    assert {12, 14} < set(steps)  # the student's rollouts, after those of its teachers and 6 updates
    assert "fit-0/validation_loss" in next(row for row in killed.rows if row["step"] == 10)
    assert "fit/validation_loss" in killed.rows[-1]


def test_the_curve_of_a_student_whose_service_chose_the_number_of_updates_is_kept(
    distillation: Callable[..., Any], data_dir: Path
) -> None:
    run = distillation(**TWICE, config={})
    assert not run.do(stop=dataset_path(data_dir, "rollouts.0").exists)  # no fit: imitation is away
    fitted = {"step": 4 + 5000, "fit-0/validation_loss": 0.5}
    with (run.folder / "metrics.jsonl").open("a") as metrics:
        metrics.write(json.dumps(fitted) + "\n")
    write_atomic(run.folder / "parts" / "fit-0" / "model.json", b'{"name": "language.0", "version": ""}')
    run.context().tell_wait("")
    assert not run.do(stop=lambda: bool(run.waiting))
    assert run.rows[-1] == fitted
    assert _updates_before(run.context(), run.config, 1) == 5000


def test_another_dataset_of_the_name_that_an_iteration_needs_is_not_fitted_to(
    distillation: Callable[..., Any], data_dir: Path
) -> None:
    run = distillation(**TWICE)
    assert not run.do(stop=(run.folder / "rollouts" / "data").is_dir)
    other = dataset_path(data_dir, "rollouts.0")
    shutil.copytree(run.folder / "rollouts", other)
    with pytest.raises(AlreadyExists):
        run.do()


@pytest.mark.fault("O14")
def test_teachers_that_cannot_have_one_student_are_refused_with_the_difference_before_anything_is_done(
    distillation: Callable[..., Any], data_dir: Path
) -> None:
    teach(
        data_dir,
        "c" * 32,
        spec=ActorCriticSpec(height=32, width=32, channels=3, action_size=2, feature_size=8, hidden_size=8),
    )
    teach(data_dir, "d" * 32, camera="front")
    (data_dir / "runs" / ("e" * 32)).mkdir()
    refusals = {
        "c": "teacher 1: camera top, 33 x 30 x 3, one of 5 actions; teacher 2: camera top, 32 x 32 x 3, 2 numbers",
        "d": "teacher 2: camera front",
        "e": "must have made a policy",
        "f": "step of the pipeline; got `fff",
    }
    for letter, told in refusals.items():
        run = distillation(teachers=["a" * 32, letter * 32])
        for refused in (run.check, run.do):
            with pytest.raises(InvalidInput, match=told):
                refused()
        assert not (run.folder / "rollouts").exists()
    with pytest.raises(InvalidInput, match="student must have"):
        distillation(config={"cameras": ["front"]}).check()
    with pytest.raises(InvalidInput, match="must be of the kind ppo; images is of the kind collect"):
        distillation(teachers=["images"]).check(images="collect")


def test_a_student_with_goal_eye_gets_its_first_teachers_object_encoder_with_the_phrases_that_it_locates(
    distillation: Callable[..., Any], data_dir: Path
) -> None:
    store = ModelStore(CLONE_MODELS / "reward")
    model, goal_text = ModelRef("default", store.active_version("default")), "a red block to the left of a green block"
    card = {"task": "blocks.red-left-of-green", "camera": "front", "goal_text": goal_text, "eye": vars(model)}
    camera = Camera("front", 64, 64, 3)
    encoder = load_reward_encoder(store.folder(model), goal_caption=goal_text, camera=camera)
    plain = ActorCriticSpec(height=64, width=64, channels=3, action_size=3, feature_size=8, hidden_size=8)
    teach(data_dir, "a" * 32, spec=replace(plain, eye=encoder.spec), **card)
    teach(data_dir, "b" * 32, spec=plain, **card)
    lesson = {"rollouts": 1, "num_envs": 1, "config": {**TINY, "encoder": "goal_eye"}}
    run = distillation(**lesson, teachers=["a" * 32])
    assert not run.do(stop=(run.folder / "artifacts" / "dataset.json").exists)  # no fit: imitation is away

    dataset = dataset_path(data_dir, "rollouts")
    shared, described = load_object_encoder(dataset / "eye")
    assert shared.spec.phrases == ("a red block", "a green block", "a yellow block", "a blue block")
    assert (described["model"], described["camera"]) == (vars(model), "front")
    frames = torch.from_numpy(Dataset(dataset)[0].frames["front"].copy())
    teacher = load_policy(data_dir / "runs" / ("a" * 32) / "artifacts", device="cpu").network.eye
    assert teacher is not None
    pairs = torch.tensor([[encoder.spec.first, encoder.spec.second]]).expand(len(frames), -1)
    assert torch.equal(shared.of_pair(shared(frames), pairs), teacher(frames))

    with pytest.raises(InvalidInput, match="it has an image encoder"):
        distillation(**lesson, teachers=["b" * 32], dataset="blind").check()
    gone = {"name": "default", "version": "0" * 12}
    teach(data_dir, "a" * 32, spec=replace(plain, eye=encoder.spec), **card | {"eye": gone})
    orphan = distillation(**lesson, teachers=["a" * 32], dataset="orphan")
    with pytest.raises(NotFound):
        orphan.do()
    assert not (orphan.folder / "rollouts").exists()


@pytest.mark.parametrize("taken", ["rollouts", "rollouts.0"])
def test_a_name_that_a_dataset_has_already_is_refused(
    distillation: Callable[..., Any], data_dir: Path, taken: str
) -> None:
    dataset_path(data_dir, taken).mkdir(parents=True)
    with pytest.raises(AlreadyExists):
        distillation(**TWICE).do()


def test_rollouts_that_cannot_be_moved_to_their_place_are_not_said_to_have_a_taken_name(
    distillation: Callable[..., Any], data_dir: Path
) -> None:
    run = distillation()
    (run.folder / "rollouts").mkdir()
    (run.folder / "artifacts").mkdir()
    (run.folder / "artifacts" / "dataset.json").write_text("{}")
    (data_dir / "datasets").mkdir()
    (data_dir / "datasets" / "rollouts").write_text("no folder")
    with pytest.raises(OSError) as raised:  # noqa: PT011  # its number is what matters
        run.do()
    assert raised.value.errno == errno.ENOTDIR


def test_a_teacher_is_asked_of_every_frame_from_the_first_on_and_told_what_was_executed_before() -> None:
    store = ModelStore(CLONE_MODELS / "reward")
    folder, camera = store.folder(ModelRef("default", store.active_version("default"))), Camera("front", 64, 64, 3)
    eye = load_reward_encoder(folder, goal_caption="a red block to the left of a green block", camera=camera).spec
    size = {"height": 64, "width": 64, "channels": 3, "feature_size": 8, "hidden_size": 8}
    network = init_network(ActorCriticSpec(**size, action_size=3, recurrent=True, eye=eye), torch.Generator())
    draws = np.random.default_rng(0)

    def episode(length: int) -> Episode:
        frames = draws.integers(256, size=(length + 1, 64, 64, 3), dtype=np.uint8)
        actions = draws.uniform(-1, 1, size=(length, 3)).astype(np.float32)
        nothing = np.zeros(length, np.bool_), np.zeros((length + 1, 0)), np.zeros(0, np.float32)
        return Episode({"front": frames}, actions, *nothing, success=False, goal_index=None, goal_confidence=None)

    @torch.no_grad()
    def answered(each: Episode) -> Any:
        frames, actions = torch.from_numpy(each.frames["front"][:-1]), torch.from_numpy(each.actions)
        last = torch.cat([torch.zeros(1, 3), actions[:-1]])
        starts = torch.arange(len(actions)) == 0
        observations = network.observe(frames, last, torch.zeros(len(actions), 0), starts)
        outputs = network(observations[:, None], starts[:, None], torch.zeros(1, network.spec.recurrent_size))
        return outputs.actions.mode()[:, 0].clamp(-1, 1)

    episodes = [episode(2), episode(4)]
    for each, told in zip(episodes, relabelled(episodes, StoredPolicy(network, {"camera": "front"})), strict=True):
        torch.testing.assert_close(torch.from_numpy(told.actions), answered(each))


@pytest.mark.parametrize(
    "wrong",
    [
        {"teachers": []},
        {"teachers": ["../a"]},
        {"rollouts": 0},
        {"dagger_iterations": -1},
        {"dagger_iterations": 1, "dataset": "a" * 63},
        {"config": {"method": "skills"}},
        {"config": {"steps": -5}},
        {"task": "a"},
    ],
)
def test_what_is_no_distillation_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(InvalidInput) as error:
        KINDS["distill"].parse(DISTILL | wrong)
    assert error.value.field.startswith("config")


def test_only_rollouts_in_whose_last_frame_the_reward_model_sees_the_goal_are_kept_when_asked_for(
    distillation: Callable[..., Any], start_service: Callable[..., Any], data_dir: Path
) -> None:
    address, goal_text = start_service("freerein_reward").address, "a red block apart from a green block"
    spec = ActorCriticSpec(height=64, width=64, channels=3, action_size=3, feature_size=8, hidden_size=8)
    card = {"task": "blocks.red-left-of-green", "camera": "front", "goal_text": goal_text, "reward": "learned"}
    model = {"name": "", "version": ""}
    teach(data_dir, "a" * 32, spec=spec, **card, model=model)
    recorded = {}
    for keep in ("all", "rewarded"):
        lesson = {"teachers": ["a" * 32], "rollouts": 4, "num_envs": 4, "stochastic": True, "keep": keep}
        run = distillation(dataset=keep, reward=address, **lesson)
        assert not run.do(stop=(run.folder / "artifacts" / "dataset.json").exists)  # no fit: imitation is away
        recorded[keep] = list(Dataset(dataset_path(data_dir, keep)))
    with SyncClient(RewardClient(Channel(address))) as reward:
        last = np.stack([trajectory.frames["front"][-1] for trajectory in recorded["all"]])
        rewards = reward.reward(RewardRequest(goal_text, {"front": last})).rewards
    rewarded = [trajectory for trajectory, each in zip(recorded["all"], rewards, strict=True) if each > 0]
    assert 0 < len(rewarded) < 4
    lengths = np.array([len(trajectory.actions) for trajectory in recorded["all"]])
    judged = reached.read(dataset_path(data_dir, "all"), lengths)  # what the student learns to say
    assert [each[-1] for each in judged] == (rewards > 0).tolist()
    for ours, theirs in zip(recorded["rewarded"], rewarded, strict=True):
        np.testing.assert_array_equal(ours.actions, theirs.actions)

    card["goal_text"] = "a crimson block apart from a green block"
    teach(data_dir, "a" * 32, spec=spec, **card, model=model)
    for keep in ("all", "rewarded"):
        unknown = distillation(dataset=f"unknown-{keep}", reward=address, teachers=["a" * 32], keep=keep)
        with pytest.raises(InvalidInput, match="does not know crimson"):
            unknown.do()
        assert not (unknown.folder / "rollouts").exists()

    with pytest.raises(InvalidInput, match="got None"):
        distillation(teachers=["b" * 32], keep="rewarded").check()
