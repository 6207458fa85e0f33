"""A fit of an inverse model: the action that leads from one image to the next."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from freerein.data import DatasetSpec, create, dataset_path
from freerein.types.common import ActionSpec, Trajectory
from freerein_imitation.methods import METHODS
from freerein_imitation.model.policy import Policy

SIDE, STEP = 16, 2.0
FAST = {"method": "inverse_model", "steps": 150, "batch_size": 8, "features": 32, "hidden_size": 32}


def picture(places: npt.NDArray[np.float64]) -> npt.NDArray[np.uint8]:
    """Returns a soft white column at each place (T,), in pixels: uint8 (T, 16, 16, 1)."""
    columns = np.exp(-((np.arange(SIDE) - places[:, None]) ** 2) / 8)  # (T, 16)
    return (255 * columns).astype(np.uint8)[:, None, :, None].repeat(SIDE, axis=1)


@pytest.fixture(scope="module")
def policy(tmp_path_factory: pytest.TempPathFactory, run_fit: Callable[..., Path]) -> Policy:
    """An inverse model of a column that wanders about: an action is how far it moves."""
    data_dir, rng = tmp_path_factory.mktemp("data"), np.random.default_rng(0)
    action = ActionSpec(1, 0, ("right",))
    spec = DatasetSpec(fps=10, cameras={"front": (SIDE, SIDE, 1)}, action=action, robot_type="test")
    with create(dataset_path(data_dir, "play"), spec) as writer:
        for _ in range(20):
            moves = rng.uniform(-1, 1, (30, 1)).astype(np.float32)
            places = SIDE / 2 + np.abs((np.cumsum(STEP * moves) + 4) % 16 - 8) - 4
            moves[:-1, 0] = np.diff(places) / STEP
            writer.append(Trajectory({"front": picture(places)}, moves))
    return METHODS.load(run_fit(data_dir, "play", FAST), "cpu")


def test_it_infers_the_action_between_two_images(policy: Policy) -> None:
    rng = np.random.default_rng(1)
    here, moves = rng.uniform(5, 11, 64), rng.uniform(-1, 1, 64)
    goals = policy.encode_goals({"front": picture(here + STEP * moves)})
    output = policy.step({"front": picture(here)}, goals, np.zeros((64, 1), np.float32), np.zeros((64, 0), np.float32))
    assert np.abs(output.actions[:, 0, 0] - moves).mean() < 0.15  # 0.5 for no movement


def test_it_has_no_memory_and_follows_goal_images(policy: Policy) -> None:
    spec = policy.spec
    assert (spec.goal_form, spec.recurrent_size, spec.predicts_reached, spec.max_steps_per_goal) == (
        "images",
        0,
        True,
        30,
    )
    frames, recurrent = {"front": picture(np.array([5.0]))}, np.zeros((1, 0), np.float32)
    goal = policy.encode_goals(frames)
    still, moved = (policy.step(frames, goal, np.full((1, 1), value, np.float32), recurrent) for value in (0, 1))
    np.testing.assert_array_equal(still.actions, moved.actions)
    assert still.reached[0] > 0.9
