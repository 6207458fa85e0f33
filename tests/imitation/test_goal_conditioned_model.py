import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import torch

from freerein.errors import InvalidInput
from freerein.learning import model_files, weights
from freerein.types.common import ActionSpec
from freerein_imitation import model
from freerein_imitation.model import (
    GoalConditionedNetwork,
    GoalConditionedPolicy,
    GoalConditionedSpec,
    Handshake,
    action_code,
)

CONTINUOUS = GoalConditionedSpec(camera="front", height=24, width=20, action_size=2, features=16, hidden=12)
DISCRETE = replace(CONTINUOUS, channels=1, action_size=1, action_choices=4)
SPECS = pytest.mark.parametrize("spec", [CONTINUOUS, DISCRETE], ids=["continuous", "discrete"])


def handshake(spec: GoalConditionedSpec) -> Handshake:
    return Handshake(ActionSpec(spec.action_size, spec.action_choices, ("dy", "dz")[: spec.action_size]), 0.04, 0.9, 30)


def network(spec: GoalConditionedSpec) -> GoalConditionedNetwork:
    made = GoalConditionedNetwork(spec)
    weights.initialise(made, generator=torch.Generator().manual_seed(0))
    made.calibrate(torch.from_numpy(images(spec, 8)))
    return made


def images(spec: GoalConditionedSpec, count: int, *, seed: int = 0) -> npt.NDArray[np.uint8]:
    shape = (count, spec.height, spec.width, spec.channels)
    return np.random.default_rng(seed).integers(0, 256, shape, np.uint8)


def nothing_executed(spec: GoalConditionedSpec, count: int) -> npt.NDArray[np.float32] | npt.NDArray[np.int64]:
    return np.full((count, 1), -1, np.int64) if spec.action_choices else np.zeros((count, 2), np.float32)


@SPECS
def test_a_step_alone_is_the_same_as_in_a_batch(spec: GoalConditionedSpec) -> None:
    policy = GoalConditionedPolicy(network(spec), handshake(spec))
    rng = np.random.default_rng(1)
    memory = rng.standard_normal((5, policy.memory_size)).astype(np.float32)
    frames, previous = images(spec, 5, seed=2), nothing_executed(spec, 5)
    goals = policy.encode_goals(images(spec, 5, seed=3))
    together = policy.step(frames, goals, previous, memory)
    for one in (slice(i, i + 1) for i in range(5)):
        alone = policy.step(frames[one], goals[one], previous[one], memory[one])
        np.testing.assert_allclose(alone.actions, together.actions[one], atol=1e-5)
        np.testing.assert_allclose(alone.reached, together.reached[one], atol=1e-5)
        np.testing.assert_allclose(alone.memory, together.memory[one], atol=1e-5)


@SPECS
def test_actions_are_what_the_spec_says(spec: GoalConditionedSpec) -> None:
    policy = GoalConditionedPolicy(network(spec), handshake(spec))
    memory = np.zeros((3, policy.memory_size), np.float32)
    step = policy.step(images(spec, 3), policy.encode_goals(images(spec, 3)), nothing_executed(spec, 3), memory)
    assert step.actions.shape == (3, policy.horizon, policy.action_size)
    assert step.actions.dtype == (np.int64 if spec.action_choices else np.float32)
    assert step.actions.min() >= (0 if spec.action_choices else -1)
    assert step.actions.max() <= (3 if spec.action_choices else 1)
    assert step.memory.shape == memory.shape


@SPECS
def test_arrays_that_cannot_be_written_to_are_left_alone(spec: GoalConditionedSpec) -> None:
    policy = GoalConditionedPolicy(network(spec), handshake(spec))
    frames = np.frombuffer(images(spec, 2).tobytes(), np.uint8).reshape(2, spec.height, spec.width, spec.channels)
    memory = np.frombuffer(bytes(8 * policy.memory_size), np.float32).reshape(2, -1)
    step = policy.step(frames, policy.encode_goals(frames), nothing_executed(spec, 2), memory)
    assert np.isfinite(step.memory).all()


def test_what_was_executed_what_is_remembered_and_the_goal_all_count() -> None:
    policy = GoalConditionedPolicy(network(CONTINUOUS), handshake(CONTINUOUS))
    frame, goals = images(CONTINUOUS, 1), policy.encode_goals(images(CONTINUOUS, 2, seed=4))
    still, memory = np.zeros((1, 2), np.float32), np.zeros((1, policy.memory_size), np.float32)
    plain = policy.step(frame, goals[:1], still, memory)
    for other in (
        policy.step(frame, goals[1:], still, memory),
        policy.step(frame, goals[:1], still + 1, memory),
        policy.step(frame, goals[:1], still, memory + 1),
    ):
        assert not np.allclose(plain.actions, other.actions, atol=1e-6)


def test_without_the_previous_action_it_does_not_count() -> None:
    spec = replace(CONTINUOUS, use_previous_action=False)
    policy = GoalConditionedPolicy(network(spec), handshake(spec))
    frame, memory = images(spec, 1), np.zeros((1, policy.memory_size), np.float32)
    goal, still = policy.encode_goals(images(spec, 1)), np.zeros((1, 2), np.float32)
    moved = policy.step(frame, goal, still + 1, memory)
    np.testing.assert_array_equal(policy.step(frame, goal, still, memory).actions, moved.actions)


@SPECS
def test_a_model_on_disk_acts_as_it_did(spec: GoalConditionedSpec, tmp_path: Path) -> None:
    trained = network(spec)
    model_files.save_model(trained, tmp_path, card={"kind": "goal_conditioned", **handshake(spec).to_card()})
    before, after = GoalConditionedPolicy(trained, handshake(spec)), model.load(tmp_path, "cpu")
    assert isinstance(after, GoalConditionedPolicy)
    assert (after.action, after.control_dt_s) == (before.action, 0.04)
    assert (after.reached_threshold, after.max_steps_per_goal, after.skills) == (0.9, 30, ())
    memory, goals = np.zeros((2, before.memory_size), np.float32), images(spec, 2, seed=5)
    steps = [
        each.step(images(spec, 2), each.encode_goals(goals), nothing_executed(spec, 2), memory)
        for each in (before, after)
    ]
    np.testing.assert_array_equal(steps[0].actions, steps[1].actions)
    np.testing.assert_array_equal(steps[0].reached, steps[1].reached)


@pytest.mark.parametrize(
    "change",
    [{"kind": "pilot"}, {"kind": None}, {"handshake": {}}, {"spec": {}}, {"spec": {"camera": "front", "channels": 2}}],
)
def test_a_card_that_says_something_else_is_refused(change: dict[str, object], tmp_path: Path) -> None:
    model_files.save_model(
        network(CONTINUOUS), tmp_path, card={"kind": "goal_conditioned", **handshake(CONTINUOUS).to_card()}
    )
    card = tmp_path / model_files.CARD
    card.write_text(json.dumps({**json.loads(card.read_text()), **change}))
    with pytest.raises(InvalidInput):
        model.load(tmp_path, "cpu")


@pytest.mark.parametrize("number", ["control_dt_s", "reached_threshold", "max_steps_per_goal"])
def test_a_handshake_out_of_range_is_refused(number: str) -> None:
    card = handshake(CONTINUOUS).to_card()
    assert isinstance(card["handshake"], dict)
    card["handshake"][number] = -1
    with pytest.raises(InvalidInput):
        Handshake.from_card(card)


def test_the_code_of_an_action_has_the_action_as_its_mean() -> None:
    actions = torch.tensor([[-1.0, -0.33], [0.0, 1.0], [0.5, 0.91]])
    code = action_code.encode(actions, choices=0)
    torch.testing.assert_close(code.sum(dim=-1), torch.ones(3, 2))
    assert (code > 0).sum(dim=-1).max() == 2
    torch.testing.assert_close(action_code.decode(code.clamp(min=1e-30).log(), choices=0), actions)


def test_the_code_of_a_discrete_action_is_its_place_and_of_none_nothing() -> None:
    code = action_code.encode(torch.tensor([[2], [-1]]), choices=3)
    assert code.tolist() == [[[0, 0, 1]], [[0, 0, 0]]]
    assert action_code.decode(code[:1], choices=3).tolist() == [[2]]
