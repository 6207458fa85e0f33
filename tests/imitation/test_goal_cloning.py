"""Goal-conditioned cloning in a world of a hand, a white dot that actions move, and a block, which only time moves."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import torch

from freerein import metrics
from freerein.data import DatasetSpec, create, dataset_path
from freerein.errors import InvalidInput
from freerein.learning.inputs import spec_of
from freerein.learning.training_loop import fit
from freerein.learning.trajectories import Trajectories
from freerein.types.common import ActionSpec, Camera, Trajectory
from freerein_imitation.methods import METHODS
from freerein_imitation.methods.goal_cloning.config import GoalCloningConfig
from freerein_imitation.methods.goal_cloning.goal_windows import (
    GoalWindows,
    lookalikes,
    sample_change_pairs,
    sample_goal_pairs,
    sample_windows,
)
from freerein_imitation.methods.goal_cloning.losses import GoalCloningLearner
from freerein_imitation.methods.goal_cloning.network import GoalCloningNetwork, GoalCloningSpec
from freerein_imitation.methods.goal_cloning.odometry_recognizer import OdometryRecognizer
from freerein_imitation.methods.goal_cloning.policy import GoalCloningPolicy
from freerein_imitation.model.policy import ControlSpec

SIDE = 16
CPU = torch.device("cpu")
CAMERAS = (Camera("front", SIDE, SIDE, 3),)
ACTION = ActionSpec(2, 0, ("down", "right"))
CONTROL = ControlSpec(0.1, 0.5, 12)
FAST = GoalCloningConfig(
    steps=100, batch_size=4, lr=5e-3, features=40, hidden_size=64, evaluate_every=50, close_steps=6, far_steps=8
)


def picture(hands: npt.NDArray[np.float64], blocks: npt.NDArray[np.float64]) -> npt.NDArray[np.uint8]:
    """Returns frames uint8 (T, 16, 16, 3) of a white hand and a red block at places (T, 2), in pixels."""
    hand, block = (_dots(places)[..., None] for places in (hands, blocks))
    return (255 * np.clip(hand + block * np.array([1.0, 0.0, 0.0]), 0, 1)).astype(np.uint8)


def _dots(places: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    axis = np.arange(SIDE)
    rows, columns = (np.exp(-((axis - places[:, i : i + 1]) ** 2) / 2) for i in (0, 1))
    return rows[:, :, None] * columns[:, None]


def explore(count: int, *, seed: int, length: int = 40) -> Trajectories:
    """Returns trajectories of a hand that wanders about a place; after half of the timesteps the block jumps."""
    rng = np.random.default_rng(seed)
    frames, actions = [], []
    for _ in range(count):
        out = rng.uniform(-1, 1, (length // 10, 1, 2)).repeat(5, axis=1)
        done = np.concatenate([out, -out], axis=1).reshape(-1, 2).astype(np.float32)  # out and back, so nothing is hit
        hands = rng.uniform(6, SIDE - 7, 2) + np.cumsum(done, axis=0) - done
        blocks = np.repeat(rng.uniform(3, SIDE - 4, (2, 2)), length // 2, axis=0)
        frames.append(picture(hands, blocks))
        actions.append(done)
    return Trajectories({"front": frames}, actions)


def hands_of(exploration: Trajectories) -> npt.NDArray[np.float32]:
    """Returns where the hand of the first trajectory is at each timestep, from an arbitrary origin: float32 (T, 2)."""
    actions = np.asarray(exploration.actions[0], np.float32)
    return np.cumsum(actions, axis=0) - actions


def learner(config: GoalCloningConfig = FAST, *, action: ActionSpec = ACTION, count: int = 40) -> GoalCloningLearner:
    data = [explore(count, seed=0), explore(10, seed=1)]
    if action.choices:
        data = [
            Trajectories(each.frames, [(np.asarray(done)[:, :1] > 0).astype(np.int64) for done in each.actions])
            for each in data
        ]
    spec = spec_of(config, GoalCloningSpec, cameras=CAMERAS, action=action)
    return GoalCloningLearner(config, spec, data[0], data[1], "fingerprint", CPU)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> GoalCloningNetwork:
    made = learner()
    fitted = fit(made, tmp_path_factory.mktemp("fit"))
    assert fitted is not None
    made.calibrate(fitted.network)
    return fitted.network


@pytest.fixture(scope="module")
def policy(trained: GoalCloningNetwork) -> GoalCloningPolicy:
    return GoalCloningPolicy(trained, CONTROL)


def test_unseen_goals_are_reached_and_recognised(policy: GoalCloningPolicy) -> None:
    rng = np.random.default_rng(2)
    here, there, blocks = rng.uniform(4, 11, (3, 64, 2))
    goals, before = policy.encode_goals({"front": picture(there, blocks)}), np.linalg.norm(here - there, axis=1)
    previous, recurrent = np.zeros((64, 2), np.float32), np.zeros((64, policy.spec.recurrent_size), np.float32)
    reached, off = [], []
    for _ in range(15):
        step = policy.step({"front": picture(here, blocks)}, goals, previous, recurrent)
        reached.append(step.reached)
        off.append(np.abs(here - there).max(axis=1))
        previous, recurrent = step.actions[:, 0], step.recurrent
        here = np.clip(here + previous, 1, SIDE - 2)
    assert off[-1].mean() < before.mean() / 4
    assert metrics.auroc(np.concatenate(reached), np.concatenate(off) <= 0.5) > 0.9


def test_a_goal_is_not_reached_where_something_else_has_moved(policy: GoalCloningPolicy) -> None:
    rng = np.random.default_rng(3)
    hands = rng.uniform(3, 6, (32, 2))
    here, there = hands + 4, hands + 8
    seen = {"front": picture(hands, here)}
    unchanged, changed = (
        policy.step(seen, policy.encode_goals({"front": picture(hands, blocks)}), *_nothing(policy, 32)).reached
        for blocks in (here, there)
    )
    assert unchanged.mean() > 2 * changed.mean()
    assert metrics.auroc(np.concatenate([unchanged, changed]), np.repeat([True, False], 32)) > 0.9


def test_differences_of_places_are_sums_of_actions(trained: GoalCloningNetwork) -> None:
    unseen = explore(1, seed=4, length=20)
    with torch.no_grad():
        places = trained.recognizer.places(trained.encoder({"front": torch.from_numpy(unseen.frames["front"][0])}))
    walked = hands_of(unseen)
    np.testing.assert_allclose(places.numpy() - places.numpy()[0], walked - walked[0], atol=1.0)
    assert (trained.recognizer.spread < 0.3).all()


def test_actions_that_do_not_displace_the_robot_are_warned_of(trained: GoalCloningNetwork) -> None:
    made = learner()
    targets = [np.clip(np.cumsum(done, axis=0) / 4, -1, 1) for done in map(np.asarray, made.validation.actions)]
    absolute = replace(made, validation=replace(made.validation, actions=targets))
    assert made.warnings(trained) == []
    (warning,) = absolute.warnings(trained)
    assert warning.startswith("Actions must displace the robot")
    assert "the sums of `down`, `right`:" in warning


def test_fingers_do_not_count_as_places() -> None:
    gripper = ActionSpec(3, 0, ("dy", "dz", "gripper"), "m", (0.05, 0.04, 0.02))
    recognizer = OdometryRecognizer(features=8, hidden_size=8, action=gripper)
    torch.testing.assert_close(recognizer.tolerance, torch.tensor([0.5, 0.625, 1.25]))
    assert recognizer.counts.tolist() == [True, True, False]


def test_an_observation_from_longer_ago_than_a_control_step_counts_as_none(policy: GoalCloningPolicy) -> None:
    frames = {"front": explore(1, seed=6).frames["front"][0]}
    goals, (previous, none) = policy.encode_goals(frames), _nothing(policy, 40)
    recurrent = np.roll(policy.step(frames, goals, previous, none).recurrent, 1, axis=0)
    states = policy.skip_steps(recurrent, np.arange(40) % 2)
    actions = [policy.step(frames, goals, previous, each).actions for each in (states, recurrent, none)]
    np.testing.assert_array_equal(actions[0][::2], actions[1][::2])
    np.testing.assert_array_equal(actions[0][1::2], actions[2][1::2])
    assert not np.array_equal(actions[1][1::2], actions[2][1::2])


def _nothing(policy: GoalCloningPolicy, count: int) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Returns no previous actions, and no previous observations."""
    return np.zeros((count, 2), np.float32), np.zeros((count, policy.spec.recurrent_size), np.float32)


# --- batches


def numbered(count: int, length: int) -> Trajectories:
    """Returns trajectories whose pixels tell item and timestep, 40 apart."""
    clock = np.arange(length, dtype=np.uint8)[:, None, None, None] + np.zeros((4, 4, 1), np.uint8)
    actions = [explore(1, seed=item, length=length).actions[0] for item in range(count)]
    return Trajectories({"front": [clock + 40 * item for item in range(count)]}, [np.asarray(each) for each in actions])


@pytest.fixture
def windows() -> GoalWindows:
    """Windows of three trajectories of 40, 40 and 40 timesteps, all of whose frames look alike."""
    alike = [lookalikes(torch.zeros(40, 2), far_steps=8)] * 3
    return sample_windows(numbered(3, 40), alike, [0, 2, 1, 2], np.random.default_rng(0), max_goal_steps=5, device=CPU)


def test_a_lookalike_is_far_in_time_and_looks_most_alike() -> None:
    statistics = torch.tensor([0.0, 5.0, 6.0, 9.0, 0.1, 5.1, 6.1, 9.1])[:, None]
    found = lookalikes(statistics, far_steps=3)
    assert found.shape == (8, 4)
    assert found[:4, 0].tolist() == [4, 5, 6, 7]


@pytest.mark.parametrize("length", [1, 3, 12, 1100])
def test_lookalikes_are_those_of_all_distances_at_once_also_among_equals(length: int) -> None:
    rng = np.random.default_rng(0)
    statistics = torch.from_numpy(
        rng.random((length // 4 + 1, 16), np.float32)[rng.integers(length // 4 + 1, size=length)]
    )
    near = np.abs(np.arange(length)[:, None] - np.arange(length)) < 10
    distances = torch.cdist(statistics, statistics).masked_fill(torch.from_numpy(near), torch.inf)
    np.testing.assert_array_equal(lookalikes(statistics, far_steps=10), distances.argsort(dim=1)[:, :4])


def test_frames_of_a_window_have_their_own_actions(windows: GoalWindows) -> None:
    data = numbered(3, 40)
    items, timesteps = np.divmod(windows.frames["front"][:, 0, 0, 0].numpy().astype(np.int64), 40)
    np.testing.assert_array_equal(windows.trajectories, items)
    np.testing.assert_array_equal(windows.timesteps, timesteps)
    for frame, (item, t) in enumerate(zip(items, timesteps, strict=True)):
        done = np.asarray(data.actions[item])
        np.testing.assert_array_equal(windows.actions[frame], done[t])
        np.testing.assert_array_equal(windows.previous[frame], done[t - 1] if t else np.zeros(2))
        np.testing.assert_allclose(windows.odometer[frame], done[:t].sum(axis=0), atol=1e-5)


def test_a_goal_is_a_few_actions_ahead_in_the_same_window(windows: GoalWindows) -> None:
    pairs = sample_goal_pairs(windows, np.random.default_rng(0), max_goal_steps=5)
    ahead = windows.timesteps[pairs.goals] - windows.timesteps[pairs.observations]
    np.testing.assert_array_equal(windows.trajectories[pairs.goals], windows.trajectories[pairs.observations])
    assert (ahead.min(), ahead.max()) == (1, 5)
    np.testing.assert_array_equal(np.unique(pairs.observations - pairs.before), [0, 1])
    np.testing.assert_array_equal(np.unique(ahead), np.unique(pairs.goals - pairs.observations))


def test_pairs_close_in_time_far_ones_and_strangers_are_at_places_equally_far_apart(windows: GoalWindows) -> None:
    places = np.random.default_rng(1).uniform(0, 4, (len(windows.timesteps), 2)).astype(np.float32)
    pairs = sample_change_pairs(windows, places, np.random.default_rng(0), close_steps=6, far_steps=8)
    steps = np.abs(windows.timesteps[pairs.first] - windows.timesteps[pairs.second])
    same = windows.trajectories[pairs.first] == windows.trajectories[pairs.second]
    apart = np.abs(places[pairs.first] - places[pairs.second]).max(axis=1)
    close, far, strange = pairs.is_close, pairs.is_far, ~pairs.is_close & ~pairs.is_far
    assert same[close].all()
    assert same[far].all()
    assert not same[strange].any()
    assert (steps[close].min(), steps[close].max()) == (4, 6)
    assert steps[far].min() >= 8
    assert apart[close].max() <= 1
    assert abs(apart[close].mean() - apart[far].mean()) < 0.3
    assert abs(apart[close].mean() - apart[strange].mean()) < 0.3


def test_windows_of_short_trajectories_are_whole() -> None:
    alike = [lookalikes(torch.zeros(10, 2), far_steps=8)]
    batch = sample_windows(numbered(1, 10), alike, [0], np.random.default_rng(0), max_goal_steps=5, device=CPU)
    assert batch.windows.tolist() == [[0, 10]]
    assert batch.timesteps[:10].tolist() == list(range(10))


# --- fits


def test_discrete_actions_are_learned_from_without_odometry() -> None:
    made = learner(replace(FAST, steps=2), action=ActionSpec(1, 2, ("up", "down")), count=6)
    state = made.init(torch.Generator().manual_seed(0))
    state, figures = made.update(state, np.arange(4))
    made.calibrate(state.network)
    assert np.isfinite(list(figures.values())).all()
    assert figures["odometry_loss"] == 0
    assert made.warnings(state.network) == []
    frames = {"front": explore(1, seed=5).frames["front"][0][:3]}
    policy = GoalCloningPolicy(state.network, CONTROL)
    recurrent = np.zeros((3, policy.spec.recurrent_size), np.float32)
    step = policy.step(frames, policy.encode_goals(frames), np.full((3, 1), -1), recurrent)
    assert (step.actions.shape, step.actions.dtype) == ((3, 1, 1), np.int64)
    assert ((step.reached >= 0) & (step.reached <= 1)).all()


def test_actions_that_are_targets_are_refused(tmp_path: Path) -> None:
    action = ActionSpec(2, 0, ("elbow", "wrist"), absolute=True)
    spec = DatasetSpec(fps=10, cameras={"front": (8, 8, 3)}, action=action, robot_type="arm")
    with create(dataset_path(tmp_path, "arm"), spec) as writer:
        writer.append(Trajectory({"front": np.zeros((3, 8, 8, 3), np.uint8)}, np.zeros((3, 2), np.float32)))
    assert METHODS.resolve(tmp_path, "arm", {"method": "goal_conditioned"}, threads=1)
    with pytest.raises(InvalidInput, match="are targets") as refused:
        METHODS.resolve(tmp_path, "arm", {"method": "goal_cloning"}, threads=1)
    assert refused.value.field == "dataset"
