"""Skill cloning with the robot's own state: a LeRobot dataset whose images tell nothing, and actions at every door."""

import json
import shutil
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch
from tests.faults import control_robot as robots

from freerein import images
from freerein.data import LeRobotSource, dataset_path, import_trajectories
from freerein.data.labels import LabelsInfo, LabelsWriter
from freerein.errors import InvalidInput
from freerein.learning.fit_dataset import FitDataset
from freerein.learning.model_files import read_card
from freerein.learning.training_loop import fit
from freerein.model_store import ModelStore
from freerein.serving.batcher import Batcher
from freerein.serving.health import Health
from freerein.serving.metrics import Metrics
from freerein.serving.model_cache import ModelCache
from freerein.types.common import ActionSpec, Camera, Goal, Image, ModelRef, Observation
from freerein.types.imitation import ActRequest, ControlRequest, GetSpecRequest, Hello, Observed
from freerein.types.segmentation import FLAGGED
from freerein_imitation.core import ActService, ControlService, PolicyRunner
from freerein_imitation.methods import METHODS
from freerein_imitation.methods.skill_cloning.config import SkillCloningConfig, network_spec
from freerein_imitation.methods.skill_cloning.network import SkillCloningNetwork
from freerein_imitation.methods.skill_cloning.policy import SkillCloningPolicy
from freerein_imitation.model.policy import ControlSpec
from freerein_imitation.openpi import OpenpiService
from freerein_imitation.openpi.messages import pack, unpack

SKILLS = ("away", "towards")
STEPS, EPISODES = 20, 24
CONFIG: dict[str, Any] = {
    "ends": "budget",
    "encoder": "patch",
    "features": 8,
    "hidden_size": 32,
    "memory": 1,
    "chunk": 1,
    "shift": 0,
    "steps": 150,
    "batch_size": 8,
    "span": 8,
    "lr": 1e-2,
    "evaluate_every": 50,
}
Floats = npt.NDArray[np.float32]


def frames(rng: np.random.Generator, count: int) -> npt.NDArray[np.uint8]:
    return rng.integers(0, 256, (count, 8, 8, 3), np.uint8)


def states(rng: np.random.Generator, count: int) -> Floats:
    """Returns an angle in degrees, a constant, and noise that is far from 0."""
    angle, noise = rng.uniform(-90, 90, count), 1000 + rng.normal(size=count)
    return np.stack([angle, np.full(count, 7.0), noise], axis=1).astype(np.float32)


def shown_action(state: Floats, skill: int) -> Floats:
    """Returns the demonstrator's action, float32 (N, 1)."""
    return (state[:, :1] / 100) * np.float32(1 if skill else -1)


def record(root: Path) -> None:
    """Writes a LeRobotDataset v3 as other tools do, of one file; odd episodes show the second skill."""
    rng = np.random.default_rng(0)
    state = states(rng, EPISODES * STEPS)
    action = np.concatenate([shown_action(each, skill % 2) for skill, each in enumerate(np.split(state, EPISODES))])
    rows = {
        "observation.images.front": [
            {"bytes": images.encode(each).data, "path": None} for each in frames(rng, len(state))
        ],
        "observation.state": pa.array(state.tolist(), pa.list_(pa.float32())),
        "action": pa.array(action.tolist(), pa.list_(pa.float32())),
        "episode_index": np.repeat(np.arange(EPISODES), STEPS),
    }
    image = {"dtype": "image", "shape": [8, 8, 3], "names": ["height", "width", "channels"]}
    features = {
        "observation.images.front": image,
        "observation.state": {"dtype": "float32", "shape": [3], "names": ["pan", "mode", "current"]},
        "action": {"dtype": "float32", "shape": [1], "names": ["pan"]},
        "episode_index": {"dtype": "int64", "shape": [1], "names": None},
    }
    info = {"codebase_version": "v3.0", "fps": 10, "features": features}
    info["data_path"] = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
    episodes = {"episode_index": range(EPISODES), "length": [STEPS] * EPISODES}
    episodes |= {f"data/{name}_index": [0] * EPISODES for name in ("chunk", "file")}
    for folder in ("data/chunk-000", "meta/episodes/chunk-000"):
        (root / folder).mkdir(parents=True)
    pq.write_table(pa.table(rows), root / "data/chunk-000/file-000.parquet")
    pq.write_table(pa.table(episodes), root / "meta/episodes/chunk-000/file-000.parquet")
    pq.write_table(pa.table({"task_index": [0], "task": ["move"]}), root / "meta/tasks.parquet")
    (root / "meta/info.json").write_text(json.dumps(info))


@pytest.fixture(scope="module")
def data_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data directory with `arm`, imported and labelled."""
    folder = tmp_path_factory.mktemp("data")
    record(folder / "recorded")
    root = dataset_path(folder, "arm")
    import_trajectories(LeRobotSource(folder / "recorded"), root)
    with LabelsWriter(root, name="test") as writer:
        for index in range(EPISODES):
            writer.save(index, np.full(STEPS, index % 2))
        writer.finish(LabelsInfo(SKILLS, ModelRef("segments", "0123456789ab")))
    return folder


@pytest.fixture(scope="module")
def model(data_dir: Path, run_fit: Callable[..., Path]) -> Path:
    """The folder of a model that was fitted with the robot's state."""
    return run_fit(data_dir, "arm", {"method": "skill_cloning", **CONFIG, "use_robot_state": True})


@pytest.fixture(scope="module")
def blind(data_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> SkillCloningPolicy:
    """A policy that was fitted without."""
    source, method = FitDataset.open(data_dir, "arm"), METHODS.by_name["skill_cloning"]
    config = method.config.from_mapping({**CONFIG, "cameras": ["front"], "steps": 20})
    learner = method.prepare(source, config, torch.device("cpu"))
    fitted = fit(learner, tmp_path_factory.mktemp("fit"))
    assert fitted is not None
    learner.calibrate(fitted.network)
    return SkillCloningPolicy(fitted.network, ControlSpec(0.1, 1.0, STEPS))


def error_of(policy: SkillCloningPolicy, *, with_state: bool) -> float:
    """Returns the policy's mean absolute error of actions relative to their spread, on observations of its own."""
    rng, count = np.random.default_rng(1), 200
    seen, state = {"front": frames(rng, count)}, states(rng, count)
    nothing = np.zeros((count, 1), np.float32), np.zeros((count, policy.spec.recurrent_size), np.float32)
    errors = []
    for skill, name in enumerate(SKILLS):
        felt = (state,) if with_state else ()
        actions = policy.step(seen, policy.encode_goals([name] * count), *nothing, *felt).actions[:, 0]
        expected = shown_action(state, skill)
        errors.append(np.abs(actions - expected).mean() / np.abs(expected - expected.mean()).mean())
    return float(np.mean(errors))


def test_a_state_tells_the_action_where_images_do_not(model: Path, blind: SkillCloningPolicy) -> None:
    assert error_of(METHODS.load(model, "cpu"), with_state=True) < 0.25
    assert error_of(blind, with_state=False) > 0.9


def test_states_in_other_units_are_flagged_and_others_of_its_constants_are_not(model: Path) -> None:
    policy, rng, count = METHODS.load(model, "cpu"), np.random.default_rng(4), 200
    seen, state = {"front": frames(rng, count)}, states(rng, count)
    start = np.zeros((count, 1), np.float32), np.zeros((count, policy.spec.recurrent_size), np.float32)
    goals, in_another_mode = policy.encode_goals(["towards"] * count), state.copy()
    in_another_mode[:, 1] = -1e6

    def flagged(given: Floats) -> float:
        return float((policy.step(seen, goals, *start, given).in_distribution < FLAGGED).mean())

    assert flagged(state) == flagged(in_another_mode) < 0.2
    assert flagged(np.radians(state).astype(np.float32)) == 1.0


def test_the_card_says_that_the_state_was_used(model: Path) -> None:
    card = read_card(model)
    assert card["spec"]["robot_state_size"] == 3
    assert card["supervision"].startswith("images, the robot's own state and executed actions")
    assert "--set use_robot_state=true" in card["command"]


@dataclass(frozen=True)
class Doors:
    act: ActService
    control: ControlService
    openpi: OpenpiService


@pytest.fixture
async def doors(model: Path, tmp_path: Path) -> AsyncIterator[Doors]:
    store = ModelStore(tmp_path / "models")
    store.activate(store.publish("", Path(shutil.copytree(model, tmp_path / "unpublished"))))
    models: Any = ModelCache(store, lambda folder: METHODS.load(folder, "cpu"), fit_command="none")
    batcher = Batcher(PolicyRunner().run_batch, queue=64, batch=32, metrics=Metrics())
    yield Doors(
        ActService(models, batcher),
        ControlService(models, batcher, health=Health(), drain_s=5.0),
        OpenpiService(models, batcher),
    )
    batcher.close()


async def test_every_door_takes_the_state_and_refuses_to_act_without(doors: Doors, model: Path) -> None:
    rng, goal = np.random.default_rng(2), Goal(recipe=("towards",))
    pixels, state = frames(rng, 1)[0], states(rng, 1)[0]
    policy = METHODS.load(model, "cpu")
    start = np.zeros((1, 1), np.float32), np.zeros((1, policy.spec.recurrent_size), np.float32)
    expected = policy.step({"front": pixels[None]}, policy.encode_goals(["towards"]), *start, state[None]).actions[0]
    image = Image("raw_rgb8", 8, 8, pixels.tobytes(), "front")
    whole, stateless = Observation((image,), state), Observation((image,))

    acted = await doors.act.act(ActRequest(whole, goal))
    np.testing.assert_allclose(acted.actions, expected, atol=1e-5)
    with pytest.raises(InvalidInput, match=r"float32 of shape \(3,\), as in training; got none"):
        await doors.act.act(ActRequest(stateless, goal))

    spec = await doors.act.get_spec(GetSpecRequest())
    stream = robots.Stream(doors.control.control)
    hello = Hello(goal, (Camera("front", 8, 8, 3),), spec.action, spec.control_dt_s, valid_for_s=30.0)
    assert (await stream.ask(ControlRequest(hello=hello))).spec.robot_state_size == spec.robot_state_size == 3
    assert (await stream.ask(ControlRequest(observed=Observed(0, stateless)))).error.field == "observation.state"
    chunk = (await stream.ask(ControlRequest(observed=Observed(1, whole)))).chunk
    np.testing.assert_array_equal(chunk.actions, acted.actions)

    connection = await doors.openpi.open([("goal.recipe", "towards")])
    assert unpack(connection.greeting)["robot_state_size"] == 3
    answered = unpack(await connection.answer(pack({"observation/front": pixels, "observation/state": state})))
    np.testing.assert_array_equal(answered["actions"], acted.actions)
    with pytest.raises(InvalidInput, match=r"got float64 \(3,\)"):
        await connection.answer(pack({"observation/front": pixels, "observation/state": state.astype(np.float64)}))


def test_a_dataset_without_a_state_is_refused_before_the_fit_is_queued(data_dir: Path) -> None:
    info = data_dir / "recorded/meta/info.json"
    document = json.loads(info.read_text())
    del document["features"]["observation.state"]
    info.write_text(json.dumps(document))
    root = dataset_path(data_dir, "stateless")
    import_trajectories(LeRobotSource(data_dir / "recorded"), root)
    shutil.copytree(dataset_path(data_dir, "arm") / "labels", root / "labels")
    values = {"method": "skill_cloning", "use_robot_state": True}
    with pytest.raises(InvalidInput, match="needs a dataset with the robot's own state") as error:
        METHODS.resolve(data_dir, "stateless", values, threads=1)
    assert (error.value.field, bool(error.value.hint)) == ("config.use_robot_state", True)


def test_a_state_counts_in_its_own_units_and_its_constants_not_at_all() -> None:
    action, cameras = ActionSpec(1, 0, ("pan",)), (Camera("front", 8, 8, 3),)
    config = SkillCloningConfig(encoder="patch", features=8, use_robot_state=True)
    network = SkillCloningNetwork(
        network_spec(config, cameras=cameras, action=action, skills=SKILLS, robot_state_size=3)
    )
    rng = np.random.default_rng(3)
    shown, seen = torch.from_numpy(states(rng, 500)), {"front": torch.from_numpy(frames(rng, 500))}

    def standardised(units: float, *, constant: float = 7.0) -> torch.Tensor:
        network.fit_robot_state(shown * units)
        given = shown.clone()
        given[:, 1] = constant
        return network.encode(seen, given * units)[:, -3:]

    found = standardised(1.0)
    torch.testing.assert_close(found.std(dim=0, correction=0), torch.tensor([1.0, 0.0, 1.0]), atol=1e-3, rtol=0)
    torch.testing.assert_close(found.mean(dim=0), torch.zeros(3), atol=1e-3, rtol=0)
    torch.testing.assert_close(standardised(0.017), found, atol=1e-2, rtol=0)
    torch.testing.assert_close(standardised(1.0, constant=1e9), found)
