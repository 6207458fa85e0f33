from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import pytest
import torch

from freerein import metrics
from freerein.errors import InvalidInput
from freerein.learning.inputs import spec_of
from freerein.learning.train_state import TrainState
from freerein.learning.training_loop import fit
from freerein.learning.trajectories import Trajectories
from freerein.types.common import ActionSpec, Camera
from freerein_imitation.methods.goal_conditioned.config import GoalConditionedConfig
from freerein_imitation.methods.goal_conditioned.losses import GoalConditionedLearner
from freerein_imitation.methods.goal_conditioned.network import GoalConditionedNetwork, GoalConditionedSpec
from freerein_imitation.methods.shared.goal_images.policy import GoalImagesPolicy
from freerein_imitation.methods.shared.goal_images.recognizer_losses import reached_threshold
from freerein_imitation.methods.shared.goal_images.relabelling import RecognizerBatch, sample_slices
from freerein_imitation.model.policy import ControlSpec

SIDE = 16
STEP = 1.0
CPU = torch.device("cpu")
CAMERAS = (Camera("front", SIDE, SIDE, 1),)
ACTION = ActionSpec(2, 0, ("down", "right"))
FAST = GoalConditionedConfig(
    steps=200,
    batch_size=2,
    lr=1e-2,
    max_goal_steps=10,
    far_steps=10,
    features=32,
    hidden_size=32,
    embedding_size=16,
    evaluate_every=100,
)


def picture(places: npt.NDArray[np.float64]) -> npt.NDArray[np.uint8]:
    """Returns a soft white dot at each place (T, 2), in pixels: uint8 (T, 16, 16, 1)."""
    axis = np.arange(SIDE)
    rows = np.exp(-((axis - places[:, :1]) ** 2) / 4)[:, :, None]
    columns = np.exp(-((axis - places[:, 1:]) ** 2) / 4)[:, None]
    return (255 * rows * columns).astype(np.uint8)[..., None]


def explore(count: int, *, seed: int, length: int = 40) -> Trajectories:
    """Returns trajectories of a dot that wanders about: an action is how far it moves along each axis."""
    rng = np.random.default_rng(seed)
    frames, actions = [], []
    for _ in range(count):
        done = np.repeat(rng.uniform(-1, 1, (length // 5, 2)), 5, axis=0).astype(np.float32)
        place, places = rng.uniform(3, SIDE - 4, 2), []
        for action in done:
            places.append(place)
            place = np.clip(place + STEP * action, 0, SIDE - 1)
        frames.append(picture(np.array(places)))
        actions.append(done)
    return Trajectories({"front": frames}, actions)


def learner(
    config: GoalConditionedConfig = FAST,
    data: tuple[Trajectories, Trajectories] | None = None,
    *,
    cameras: tuple[Camera, ...] = CAMERAS,
    action: ActionSpec = ACTION,
) -> GoalConditionedLearner:
    forward_model = config.forward_consistency_weight > 0
    spec = spec_of(config, GoalConditionedSpec, cameras=cameras, action=action, forward_model=forward_model)
    seen = data or (explore(40, seed=0), explore(6, seed=1))
    return GoalConditionedLearner(config, spec, *seen, "fingerprint", CPU)


@pytest.mark.long  # 400 updates; below, one of 120 that recognises its goals
def test_unseen_goals_are_reached_and_recognised(tmp_path: Path) -> None:
    fitted = fit(learner(replace(FAST, steps=400, evaluate_every=200)), tmp_path)
    assert fitted is not None
    threshold = reached_threshold(fitted.network.recognizer, learner().validation)
    policy = GoalImagesPolicy(fitted.network, ControlSpec(0.1, threshold, 30))
    rng = np.random.default_rng(2)
    here, there = rng.uniform(4, 11, (2, 32, 2))
    goals, before = policy.encode_goals({"front": picture(there)}), np.linalg.norm(here - there, axis=1)
    previous, memory = np.zeros((32, 2), np.float32), np.zeros((32, policy.spec.recurrent_size), np.float32)
    reached, distances = [], []
    for _ in range(12):
        step = policy.step({"front": picture(here)}, goals, previous, memory)
        reached.append(step.reached)
        distances.append(np.linalg.norm(here - there, axis=1))
        previous, memory = step.actions[:, 0], step.recurrent
        here = np.clip(here + STEP * previous, 0, SIDE - 1)
    assert distances[-1].mean() < before.mean() / 2
    near = np.concatenate(distances) < 1.5
    assert metrics.auroc(np.concatenate(reached), near) > 0.9
    assert 0.5 < threshold < 1.0


def test_an_action_of_its_own_tells_that_the_goal_is_reached(tmp_path: Path) -> None:
    made = learner(replace(FAST, stop=True, encoder="patch", steps=120))
    fitted = fit(made, tmp_path)
    assert fitted is not None
    assert fitted.network.recognizer is None
    made.calibrate(fitted.network)
    policy = GoalImagesPolicy(fitted.network, ControlSpec(0.1, made.reached_threshold(fitted.network), 20))
    followed, reached = explore(32, seed=5), []
    seen = np.stack(frames_of(followed))
    goals = policy.encode_goals({"front": seen[:, 8]})
    previous, memory = np.zeros((32, 2), np.float32), np.zeros((32, policy.spec.recurrent_size), np.float32)
    for timestep in range(9):
        step = policy.step({"front": seen[:, timestep]}, goals, previous, memory)
        memory, previous = step.recurrent, np.stack([each[timestep] for each in followed.actions])
        reached.append(step.reached)
    assert metrics.auroc(np.concatenate(reached), np.arange(9).repeat(32) == 8) > 0.9
    assert reached[0].max() < policy.spec.reached_threshold < reached[-1].max()
    assert (step.in_distribution > 0).any()


def test_a_policy_without_recurrence_has_no_state_and_time_for_far_goals() -> None:
    made = learner(replace(FAST, recurrent=False, min_goal_steps=1, max_goal_steps=1))
    state = made.init(torch.Generator().manual_seed(0))
    assert set(made.update(state, np.arange(2))[1]) == {"train_loss", "action_loss", "recognizer_loss"}
    assert GoalImagesPolicy(state.network, ControlSpec(0.1, 0.5, 30)).spec.recurrent_size == 0
    assert (made.max_steps_per_goal, learner().max_steps_per_goal) == (20, 20)
    assert learner(replace(FAST, max_goal_steps=6)).max_steps_per_goal == 12


@pytest.mark.parametrize("head", ["autoregressive", "map"])
@pytest.mark.parametrize("method_keys", [{}, {"stop": True}, {"forward_consistency_weight": 0.1}])
def test_heads_of_pick_and_place_learn_with_all_else(head: str, method_keys: dict[str, Any]) -> None:
    action, seen = ActionSpec(4, 0, ("x", "y", "dx", "dy")), explore(4, seed=0, length=15)
    picks = [np.concatenate([each, 0.5 * each], axis=1) for each in seen.actions]
    data = Trajectories(seen.frames, picks)
    config = replace(FAST, steps=2, min_goal_steps=1, max_goal_steps=2, recurrent=False, head=head, **method_keys)
    made = learner(config, (data, data), action=action)
    state = made.init(torch.Generator().manual_seed(0))
    before = {name: each.clone() for name, each in state.network.policy.named_parameters("policy")}
    state, _ = made.update(state, np.arange(4))
    assert all(not torch.equal(each, before[name]) for name, each in state.network.policy.named_parameters("policy"))
    policy, frames = GoalImagesPolicy(state.network, ControlSpec(0.1, 0.5, 30)), {"front": frames_of(seen)[0][:3]}
    acted = policy.step(frames, policy.encode_goals(frames), np.zeros((3, 4), np.float32), np.zeros((3, 0), np.float32))
    assert acted.actions.shape == (3, 1, 4)
    assert np.abs(acted.actions).max() <= 1


def test_held_out_frames_have_every_in_distribution_score_alike_and_noise_has_low_ones(tmp_path: Path) -> None:
    config = replace(FAST, steps=40, warmup_steps=5, evaluate_every=40, features=128)
    made = learner(config, (explore(40, seed=0), explore(20, seed=1)))
    fitted = fit(made, tmp_path)
    assert fitted is not None
    made.calibrate(fitted.network)
    policy, ahead = GoalImagesPolicy(fitted.network, ControlSpec(0.1, 0.9, 30)), config.far_steps // 2

    def scores(frames: npt.NDArray[np.uint8], goals: npt.NDArray[np.uint8]) -> npt.NDArray[np.float32]:
        previous, recurrent = np.zeros((len(frames), 2)), np.zeros((len(frames), policy.spec.recurrent_size))
        nothing = previous.astype(np.float32), recurrent.astype(np.float32)
        return policy.step({"front": frames}, policy.encode_goals({"front": goals}), *nothing).in_distribution

    held_out = frames_of(explore(30, seed=2))
    frames, goals = (np.concatenate([each[at] for each in held_out]) for at in (slice(-ahead), slice(ahead, None)))
    told = np.sort(scores(frames, goals))
    assert np.abs(told - np.linspace(0, 1, len(told))).max() < 0.15
    noise = np.random.default_rng(0).integers(0, 256, frames.shape, np.uint8)
    assert scores(noise, goals).max() < 0.05


@pytest.mark.parametrize(
    ("use", "target", "choices"),
    [
        ("consistency", "features", 0),
        ("consistency", "pixels", 2),
        ("regulariser", "features", 2),
        ("regulariser", "pixels", 0),
    ],
)
def test_the_policy_is_trained_alone_then_a_forward_model_then_both(
    tmp_path: Path, use: Literal["consistency", "regulariser"], target: Literal["features", "pixels"], choices: int
) -> None:
    forward = {"forward_use": use, "forward_target": target, "forward_consistency_weight": 1.0}
    pretraining = {"forward_pretraining_steps": 1, "policy_pretraining_steps": 1}
    config = replace(FAST, steps=3, warmup_steps=1, features=8, evaluate_every=3, **forward, **pretraining)
    data, action = explore(2, seed=0, length=15), ACTION
    if choices:
        turns = [(data.actions[item][:, :1] > 0).astype(np.int64) for item in range(len(data))]
        data, action = Trajectories(data.frames, turns), ActionSpec(1, choices, ("up", "down"))
    made = learner(config, (data, data), action=action)

    def changed(state: TrainState[GoalConditionedNetwork]) -> set[str]:
        before = {name: each.clone() for name, each in state.network.named_parameters()}
        made.update(state, np.arange(2))
        return {name for name, each in state.network.named_parameters() if not torch.equal(each, before[name])}

    state = made.init(torch.Generator().manual_seed(0))
    parts = [{name.partition(".")[0] for name in changed(replace(state, step=step))} for step in range(3)]
    assert parts == [{"policy", "recognizer"}, {"forward_model"}, {"forward_model", "policy", "recognizer"}]

    state.network.zero_grad()
    slices = sample_slices(data, [0, 1], np.random.default_rng(0), steps=(5, 10), device=CPU)
    made.policy_losses(state.network, slices).auxiliary.backward()  # type: ignore[no-untyped-call]  # torch does not annotate it
    taught = {
        name.split(".")[1] for name, each in state.network.policy.named_parameters("policy") if each.grad is not None
    }
    acting = {"input_layer", "lstm", "action_head"}
    assert taught == {"encoder"} | (acting if use == "consistency" else set())
    assert fit(made, tmp_path) is not None


def test_keys_of_a_forward_model_need_one_and_pretraining_leaves_a_step() -> None:
    assert [each.steps for each in learner().stages()] == [0, 0, FAST.steps]
    assert learner().network().forward_model is None
    for wrong in ({"forward_use": "regulariser"}, {"forward_target": "pixels"}, {"policy_pretraining_steps": 1}):
        with pytest.raises(InvalidInput, match="is of fits with a forward model"):
            replace(FAST, **wrong)
    with pytest.raises(InvalidInput, match="must be fewer than `steps`"):
        replace(FAST, forward_consistency_weight=1.0, forward_pretraining_steps=150, policy_pretraining_steps=50)


def test_a_slice_is_a_stretch_of_one_trajectory_that_ends_in_its_goal() -> None:
    exploration = explore(3, seed=0, length=30)
    clock = np.arange(30, dtype=np.uint8)[:, None, None, None] + np.zeros((4, 4, 1), np.uint8)
    numbered = Trajectories({"front": [clock, clock + 40, clock + 80]}, exploration.actions)
    slices = sample_slices(numbered, [0, 2, 2] * 6, np.random.default_rng(0), steps=(5, 15), device=CPU)
    seen = slices.frames["front"][:, 0, 0, 0].long()
    assert (seen[slices.goals] - seen[slices.starts] == slices.lengths).all()
    assert sorted(set(slices.lengths.tolist())) == list(range(5, 16))
    assert (slices.timesteps[slices.mask] < slices.goals.repeat_interleave(slices.lengths)).all()
    for frame in range(len(seen)):
        item, timestep = divmod(int(seen[frame]), 40)
        done = exploration.actions[item]
        before = done[timestep - 1] if timestep else np.zeros(2)
        np.testing.assert_array_equal(slices.actions[frame], done[timestep])
        np.testing.assert_array_equal(slices.previous[frame], before)


def test_slices_of_a_short_trajectory_are_as_long_as_it_allows() -> None:
    slices = sample_slices(explore(1, seed=0, length=10), [0], np.random.default_rng(0), steps=(5, 15), device=CPU)
    assert slices.lengths.min() >= 5
    assert slices.goals.max() == 9


def test_pairs_are_close_far_or_from_elsewhere_and_those_in_between_count_for_nothing() -> None:
    batch = RecognizerBatch({}, torch.tensor([0, 2, 10, 20]), torch.tensor([0, 0, 0, 1]))
    close, far, elsewhere = batch.pairs(close_steps=2, far_steps=9)
    assert close.int().tolist() == [[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]]
    assert far.int().tolist() == [[0, 0, 1, 0], [0, 0, 0, 0], [1, 0, 0, 0], [0, 0, 0, 0]]
    assert elsewhere.int().tolist() == [[0, 0, 0, 1], [0, 0, 0, 1], [0, 0, 0, 1], [1, 1, 1, 0]]


def test_a_configuration_is_read_strictly_from_the_numbers_of_a_struct() -> None:
    config = GoalConditionedConfig.from_mapping({"steps": 20.0, "forward_consistency_weight": 1.0, "encoder": "patch"})
    assert config == GoalConditionedConfig(steps=20, forward_consistency_weight=1.0, encoder="patch")
    for wrong in ({"labels": True}, {"encoder": "eye"}, {"min_goal_steps": 16}, {"close_steps": 16}):
        with pytest.raises(InvalidInput):
            GoalConditionedConfig.from_mapping(wrong)


def frames_of(trajectories: Trajectories) -> list[npt.NDArray[np.uint8]]:
    return [trajectories.frames["front"][item] for item in range(len(trajectories))]
