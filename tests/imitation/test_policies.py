"""Goal-conditioned and skill policies: batching, specs, what outputs depend on, and models on disk."""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch
from freerein_imitation.model.colour_codebook import ColourCodebook, shift_horizontally
from torch import nn

from freerein.errors import InvalidInput
from freerein.learning import model_files, weights
from freerein.types.common import ActionSpec
from freerein_imitation import model
from freerein_imitation.model import action_bins
from freerein_imitation.model.goal_conditioned import (
    GoalConditionedNetwork,
    GoalConditionedPolicy,
    GoalConditionedSpec,
)
from freerein_imitation.model.policy import ControlSpec, PolicyNetworkSpec
from freerein_imitation.model.skills import SkillsNetwork, SkillsPolicy, SkillsSpec

GOALS = GoalConditionedSpec(camera="front", height=24, width=20, action_size=2, features=16, hidden_size=12)
SKILLS = SkillsSpec(skills=("pick", "push"), camera="front", height=24, width=20, action_size=2, codebook_size=4)
DISCRETE: dict[str, Any] = {"channels": 1, "action_size": 1, "action_choices": 4}


def images(spec: PolicyNetworkSpec, count: int, *, seed: int = 0) -> npt.NDArray[np.uint8]:
    shape = (count, spec.height, spec.width, spec.channels)
    return np.random.default_rng(seed).integers(0, 256, shape, np.uint8)


def goal_network(spec: GoalConditionedSpec) -> GoalConditionedNetwork:
    made = GoalConditionedNetwork(spec)
    weights.initialise(made, generator=torch.Generator().manual_seed(0))
    made.fit_normalisation(torch.from_numpy(images(spec, 8)))
    return made


def skills_network(spec: SkillsSpec) -> SkillsNetwork:
    made, generator = SkillsNetwork(spec), torch.Generator().manual_seed(0)
    weights.initialise(made, generator=generator)
    frames = torch.from_numpy(images(spec, 8))
    made.codebook.fit(frames, generator=generator)
    made.fit_normalisation(made.codebook(frames), generator=generator)
    return made


def control(spec: PolicyNetworkSpec) -> ControlSpec:
    action = ActionSpec(spec.action_size, spec.action_choices, ("dy", "dz")[: spec.action_size])
    return ControlSpec(action, 0.04, 0.9, 30)


@dataclass(frozen=True)
class Case:
    """A kind of policy with untrained weights.

    Attributes:
        spec: Spec of the network.
        make_network: Makes a network of a spec.
        make_policy: Makes a policy of a network and a control spec.
        goals: Returns `count` goals, different ones for different seeds.
    """

    spec: Any
    make_network: Callable[[Any], nn.Module]
    make_policy: Any
    goals: Callable[[Any, int, int], Any]

    def network(self) -> Any:
        return self.make_network(self.spec)

    def policy(self) -> Any:
        return self.make_policy(self.network(), control(self.spec))


def goal_images(spec: Any, count: int, seed: int) -> Any:
    return images(spec, count, seed=3 + seed)


def skill_names(spec: Any, count: int, seed: int) -> Any:
    return [spec.skills[(item + seed) % 2] for item in range(count)]


CASES = {
    "goals": Case(GOALS, goal_network, GoalConditionedPolicy, goal_images),
    "goals-discrete": Case(replace(GOALS, **DISCRETE), goal_network, GoalConditionedPolicy, goal_images),
    "skills": Case(SKILLS, skills_network, SkillsPolicy, skill_names),
    "skills-discrete": Case(replace(SKILLS, **DISCRETE, codebook_size=3), skills_network, SkillsPolicy, skill_names),
}
ALL = pytest.mark.parametrize("case", CASES.values(), ids=CASES)
CONTINUOUS = pytest.mark.parametrize("case", [CASES["goals"], CASES["skills"]], ids=["goals", "skills"])


def inputs(case: Case, policy: Any, count: int) -> list[Any]:
    """Returns frames, goal embeddings, no previous actions and random recurrent states."""
    recurrent = np.random.default_rng(1).standard_normal((count, policy.spec.recurrent_size)).astype(np.float32)
    previous = np.repeat(policy.spec.no_action()[None], count, axis=0)
    return [images(case.spec, count, seed=2), policy.encode_goals(case.goals(case.spec, count, 0)), previous, recurrent]


@ALL
def test_a_step_alone_is_the_same_as_in_a_batch(case: Case) -> None:
    policy = case.policy()
    arrays = inputs(case, policy, 5)
    together = policy.step(*arrays)
    for one in (slice(i, i + 1) for i in range(5)):
        alone = policy.step(*(array[one] for array in arrays))
        for name in ("actions", "reached", "recurrent"):
            np.testing.assert_allclose(getattr(alone, name), getattr(together, name)[one], atol=1e-5)


@ALL
def test_outputs_are_what_the_spec_says(case: Case) -> None:
    policy = case.policy()
    spec, choices = policy.spec, case.spec.action_choices
    output = policy.step(*inputs(case, policy, 3))
    assert output.actions.shape == (3, spec.horizon, spec.action.size)
    assert output.actions.dtype == (np.int64 if choices else np.float32)
    assert output.actions.min() >= (0 if choices else -1)
    assert output.actions.max() <= (choices - 1 if choices else 1)
    assert output.recurrent.shape == (3, spec.recurrent_size)
    assert ((output.reached >= 0) & (output.reached <= 1)).all()


@ALL
def test_read_only_arrays_are_accepted(case: Case) -> None:
    policy = case.policy()
    arrays = [np.frombuffer(each.tobytes(), each.dtype).reshape(each.shape) for each in inputs(case, policy, 2)]
    assert np.isfinite(policy.step(*arrays).recurrent).all()


@CONTINUOUS
def test_goal_previous_action_and_recurrent_state_all_count(case: Case) -> None:
    policy = case.policy()
    frame, goal, previous, recurrent = inputs(case, policy, 1)
    plain = policy.step(frame, goal, previous, recurrent)
    for other in (
        policy.step(frame, policy.encode_goals(case.goals(case.spec, 1, 1)), previous, recurrent),
        policy.step(frame, goal, previous + 1, recurrent),
        policy.step(frame, goal, previous, recurrent + 1),
    ):
        assert not np.allclose(plain.actions, other.actions, atol=1e-6)


def test_the_previous_action_can_be_ignored() -> None:
    spec = replace(GOALS, use_previous_action=False)
    policy = GoalConditionedPolicy(goal_network(spec), control(spec))
    frame, goal, previous, recurrent = inputs(CASES["goals"], policy, 1)
    moved = policy.step(frame, goal, previous + 1, recurrent)
    np.testing.assert_array_equal(policy.step(frame, goal, previous, recurrent).actions, moved.actions)


def test_an_unknown_skill_is_refused() -> None:
    with pytest.raises(InvalidInput, match="pick, push; 1 of 2"):
        CASES["skills"].policy().encode_goals(["pick", "fly"])


@ALL
def test_a_model_on_disk_acts_as_it_did(case: Case, tmp_path: Path) -> None:
    network, kind = case.network(), case.make_policy.kind
    model_files.save_model(network, tmp_path, card={"kind": kind, **control(case.spec).to_card()})
    before, after = case.make_policy(network, control(case.spec)), model.load(tmp_path, "cpu")
    assert type(after) is type(before)
    assert after.spec == before.spec
    outputs = [each.step(*inputs(case, each, 2)) for each in (before, after)]
    np.testing.assert_array_equal(outputs[0].actions, outputs[1].actions)
    np.testing.assert_array_equal(outputs[0].reached, outputs[1].reached)


OTHER_ACTIONS = ControlSpec(ActionSpec(3, 0, ("x", "y", "z")), 0.04, 0.9, 30).to_card()


@pytest.mark.parametrize(
    ("case", "change"),
    [
        ("goals", {"kind": "pilot"}),
        ("goals", {"kind": None}),
        ("goals", {"control": {}}),
        ("goals", OTHER_ACTIONS),
        ("goals", {"spec": {}}),
        ("goals", {"spec": {"camera": "front", "channels": 2}}),
        ("skills", {"spec": {}}),
        ("skills", {"spec": {"skills": [], "camera": "front"}}),
        ("skills", {"spec": {"skills": ["a"], "camera": "", "channels": 2}}),
    ],
)
def test_a_malformed_card_is_refused(case: str, change: dict[str, object], tmp_path: Path) -> None:
    made = CASES[case]
    card = {"kind": made.make_policy.kind, **control(made.spec).to_card()}
    model_files.save_model(made.network(), tmp_path, card=card)
    path = tmp_path / model_files.MODEL.card
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    with pytest.raises(InvalidInput):
        model.load(tmp_path, "cpu")


@pytest.mark.parametrize("number", ["control_dt_s", "reached_threshold", "max_steps_per_goal"])
def test_a_control_spec_out_of_range_is_refused(number: str) -> None:
    card: Any = control(GOALS).to_card()
    card["control"][number] = -1
    with pytest.raises(InvalidInput):
        ControlSpec.from_card(card)


# --- action bins


def test_the_distribution_of_an_action_has_the_action_as_its_mean() -> None:
    actions = torch.tensor([[-1.0, -0.33], [0.0, 1.0], [0.5, 0.91]])
    code = action_bins.encode(actions, choices=0)
    torch.testing.assert_close(code.sum(dim=-1), torch.ones(3, 2))
    assert (code > 0).sum(dim=-1).max() == 2
    torch.testing.assert_close(action_bins.decode(code.clamp(min=1e-30).log(), choices=0), actions)


def test_a_discrete_action_is_one_hot_and_no_action_is_zeros() -> None:
    code = action_bins.encode(torch.tensor([[2], [-1]]), choices=3)
    assert code.tolist() == [[[0, 0, 1]], [[0, 0, 0]]]
    assert action_bins.decode(code[:1], choices=3).tolist() == [[2]]


# --- colour codebook


def picture(*blobs: tuple[int, int, tuple[int, int, int]]) -> torch.Tensor:
    """Returns a dark frame, uint8 (1, 21, 41, 3), with a 3 x 3 blob of a colour around each (row, column)."""
    frame = np.full((1, 21, 41, 3), 20, np.uint8)
    for row, column, colour in blobs:
        frame[0, row - 1 : row + 2, column - 1 : column + 2] = colour
    return torch.from_numpy(frame)


RED, BLUE = (220, 30, 30), (30, 30, 220)


@pytest.fixture
def codebook() -> ColourCodebook:
    """A codebook of red and blue."""
    made = ColourCodebook(height=21, width=41, channels=3, size=2)
    frames = [picture((4, 3 * i + 2, RED), (15, 38 - 3 * i, BLUE)) for i in range(12)]
    made.fit(torch.cat(frames), generator=torch.Generator().manual_seed(0))
    return made


def test_a_codebook_finds_foreground_colours_and_their_positions(codebook: ColourCodebook) -> None:
    assert {tuple(colour) for colour in codebook.colours.round().int().tolist()} == {RED, BLUE}
    red = int(codebook.colours[:, 0].argmax())
    moments = codebook(picture((5, 30, RED)))[0]
    expected = np.array([30 / 20 - 1, 5 / 10 - 1]) * 9 / 9.5  # shrunk to the centre by half a pixel in nine
    np.testing.assert_allclose(moments[red, 1:3], expected, atol=1e-3)
    np.testing.assert_allclose(moments[1 - red], 0, atol=1e-3)


def test_shifted_moments_are_those_of_a_shifted_frame(codebook: ColourCodebook) -> None:
    here, there = codebook(picture((5, 12, RED), (9, 20, BLUE))), codebook(picture((5, 18, RED), (9, 26, BLUE)))
    np.testing.assert_allclose(shift_horizontally(here, torch.tensor([6 / 20])), there, atol=2e-3)


def test_a_codebook_of_frames_without_foreground_is_no_error() -> None:
    made = ColourCodebook(height=21, width=41, channels=3, size=4)
    made.fit(torch.cat([picture()] * 3), generator=torch.Generator().manual_seed(0))
    assert torch.equal(made(picture()), torch.zeros(1, 4, 5))
