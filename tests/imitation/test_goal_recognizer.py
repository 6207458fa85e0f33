"""The goal recognizer as a fit of its own, and fits of policies that copy it."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from freerein.data import DatasetSpec, create, dataset_path, save_teachers
from freerein.errors import InvalidInput, NotFound
from freerein.learning import tensor_files
from freerein.model_store import ModelStore
from freerein.types.common import ActionSpec, ModelRef, Trajectory
from freerein_imitation.methods import METHODS
from freerein_imitation.methods.shared.goal_images.config import GoalImagesConfig

SIDE = 16
ACTION = ActionSpec(1, 4, ("no-op", "forward", "left", "right"), hold=2)
RECOGNIZER = {"method": "goal_recognizer", "encoder": "convolutional", "embedding_size": 8, "far_steps": 8}
POLICY = {"steps": 2, "batch_size": 2, "features": 8, "hidden_size": 8, "encoder": "patch", "recognizer": "near"}


def seen(places: Any) -> Any:
    """Returns a bright column at each place, in pixels: uint8 (T, SIDE, SIDE, 1)."""
    columns = np.exp(-((np.arange(SIDE) - np.asarray(places)[:, None]) ** 2) / 8)
    return (255 * columns).astype(np.uint8)[:, None, :, None].repeat(SIDE, axis=1)


@pytest.fixture(scope="module")
def data_dir(tmp_path_factory: pytest.TempPathFactory, run_fit: Callable[..., Path]) -> Path:
    """A data directory with a dataset of a column that wanders about, and the recognizer `near`, fitted to it."""
    root, rng = tmp_path_factory.mktemp("data"), np.random.default_rng(0)
    cameras = {"front": (SIDE, SIDE, 1), "side": (SIDE, SIDE, 1)}
    spec = DatasetSpec(fps=10, cameras=cameras, action=ACTION, robot_type="test")
    with create(dataset_path(root, "play"), spec) as writer:
        for _ in range(12):
            moves = np.repeat(rng.integers(1, 4, 8), 4)
            frames = seen(np.abs((np.cumsum(moves - 2.0) + rng.integers(24)) % 24 - 12) + 2)
            writer.append(Trajectory({"front": frames, "side": frames}, moves[:, None]))
    publish(root, "near", run_fit(root, "play", RECOGNIZER | {"steps": 120, "batch_size": 8}))
    shutil.rmtree(root / "fit")
    return root


def publish(data_dir: Path, name: str, folder: Path) -> ModelRef:
    store = ModelStore(data_dir / "models" / "imitation")
    ref = store.publish(name, folder)
    store.activate(ref)
    return ref


def model_folder(data_dir: Path, name: str) -> Path:
    store = ModelStore(data_dir / "models" / "imitation")
    return store.folder(ModelRef(name, store.active_version(name)))


def test_served_by_itself_it_holds_and_tells_what_is_near(data_dir: Path) -> None:
    policy = METHODS.load(model_folder(data_dir, "near"), "cpu")
    here, there = np.array([4.0, 4.0, 12.0, 12.0]), np.array([4.0, 12.0, 4.0, 11.5])
    nothing = np.full((4, 1), -1), np.zeros((4, 0), np.float32)
    step = policy.step({"front": seen(here)}, policy.encode_goals({"front": seen(there)}), *nothing)
    assert step.actions.tolist() == [[[2]]] * 4
    assert ((step.reached >= policy.spec.reached_threshold) == [True, False, False, True]).all()
    assert (policy.spec.goal_form, policy.spec.recurrent_size, policy.spec.max_steps_per_goal) == ("images", 0, 16)


def test_served_by_itself_it_holds_targets_by_the_last_one(data_dir: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(model_folder(data_dir, "near"), tmp_path / "near")
    card = json.loads((folder / "card.json").read_text())
    card["spec"]["action"] |= {"size": 2, "choices": 0, "names": ["shoulder", "elbow"], "absolute": True, "hold": -1}
    (folder / "card.json").write_text(json.dumps(card))
    policy, targets = METHODS.load(folder, "cpu"), np.array([[0.25, -0.5]], np.float32)
    frames = {"front": seen([4.0])}
    step = policy.step(frames, policy.encode_goals(frames), targets, np.zeros((1, 0), np.float32))
    np.testing.assert_array_equal(step.actions, targets[:, None])


@pytest.mark.parametrize("method", ["goal_conditioned", "inverse_model"])
def test_a_policy_copies_the_recognizer_that_its_fit_names(
    data_dir: Path, run_fit: Callable[..., Path], method: str
) -> None:
    folder, near = run_fit(data_dir, "play", POLICY | {"method": method}), model_folder(data_dir, "near")
    copied, own = (tensor_files.parse((each / "model.safetensors").read_bytes()) for each in (folder, near))
    names = {name for name in own if name.startswith("recognizer.")}
    assert names == {name for name in copied if name.startswith("recognizer.")}
    assert all(copied[name].equal(own[name]) for name in names)
    card, theirs = (json.loads((each / "card.json").read_text()) for each in (folder, near))
    assert card["control"]["reached_threshold"] == theirs["control"]["reached_threshold"]
    assert (card["config"]["recognizer_version"], card["recognizer"]["version"]) == (near.name, near.name)
    assert card["recognizer"]["data"] == theirs["data"]
    assert card["supervision"].endswith(f"; those of its goal recognizer: {theirs['supervision']}")
    assert "recognizer_loss" not in card["figures"]
    policy, recognizer = METHODS.load(folder, "cpu"), METHODS.load(near, "cpu")
    frames, goals = {"front": seen([3, 4])}, {"front": seen([4, 9])}
    none = np.full((2, 1), -1)
    said = [
        each.step(frames, each.encode_goals(goals), none, np.zeros((2, each.spec.recurrent_size), np.float32)).reached
        for each in (policy, recognizer)
    ]
    np.testing.assert_array_equal(*said)
    shutil.rmtree(data_dir / "fit")


@pytest.mark.parametrize(
    "fit",
    [POLICY | {"method": "inverse_model"}, {"method": "goal_cloning", "features": 8}, RECOGNIZER],
    ids=lambda fit: fit["method"],
)
def test_a_card_says_what_policies_that_explored_were_trained_with_and_that_it_was_privileged(
    data_dir: Path, run_fit: Callable[..., Path], fit: dict[str, Any]
) -> None:
    explored = shutil.copytree(dataset_path(data_dir, "play"), dataset_path(data_dir, "explored"), dirs_exist_ok=True)
    save_teachers(explored, [{"supervision": "the true reward", "privileged": True}])
    card = json.loads((run_fit(data_dir, "explored", fit | {"steps": 2, "batch_size": 2}) / "card.json").read_text())
    assert card["privileged"] is True
    assert "of policies with this supervision: the true reward" in card["supervision"]
    shutil.rmtree(data_dir / "fit")


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"cameras": ["side"]}, "must see the cameras of the policy, side at 16 x 16 x 1; it sees front at"),
        ({"recognizer": "policy"}, "must name a model of the method goal_recognizer"),
        ({"recognizer": "nobody"}, "active model of the imitation service; got `nobody`"),
        ({"recognizer": "../datasets"}, "must"),
        ({"method": "goal_conditioned", "stop": True}, "has no goal recognizer to copy"),
    ],
)
def test_a_recognizer_that_cannot_be_copied_is_refused_before_a_fit_begins(
    data_dir: Path, tmp_path: Path, change: dict[str, Any], match: str
) -> None:
    (tmp_path / "policy").mkdir()
    (tmp_path / "policy" / "card.json").write_text('{"method": "ppo"}')
    publish(data_dir, "policy", tmp_path / "policy")
    with pytest.raises(InvalidInput, match=match) as error:
        METHODS.resolve(data_dir, "play", POLICY | {"method": "inverse_model"} | change, threads=1)
    assert error.value.field == "config.recognizer"


@pytest.mark.parametrize("key", ["close_steps", "embedding_size"])
def test_what_only_the_training_of_a_recognizer_reads_is_refused_beside_one_that_is_copied(key: str) -> None:
    with pytest.raises(InvalidInput, match=f"`{key}` is of fits that train a goal recognizer") as error:
        GoalImagesConfig(recognizer="near", **{key: 4})
    assert error.value.field == f"config.{key}"


def test_a_version_of_a_recognizer_that_there_is_not_is_not_found(data_dir: Path) -> None:
    with pytest.raises(NotFound):
        METHODS.resolve(data_dir, "play", POLICY | {"recognizer_version": "0" * 12}, threads=1)
