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
from torch import nn

from freerein.errors import InvalidInput
from freerein.learning import model_files, weights
from freerein.learning.encoders import FrameTensors
from freerein.learning.image_statistics import image_statistics
from freerein.learning.inputs import InputSpec
from freerein.types.common import ActionSpec, Camera
from freerein_imitation.core.inference import InferenceRequest, PolicyRunner
from freerein_imitation.core.inputs import Subgoal
from freerein_imitation.core.policy_state import PolicyState
from freerein_imitation.methods import METHODS
from freerein_imitation.methods.goal_cloning.network import GoalCloningNetwork, GoalCloningSpec
from freerein_imitation.methods.goal_cloning.policy import GoalCloningPolicy
from freerein_imitation.methods.goal_conditioned.network import GoalConditionedNetwork, GoalConditionedSpec
from freerein_imitation.methods.shared import action_bins
from freerein_imitation.methods.shared.goal_images.policy import GoalImagesPolicy
from freerein_imitation.methods.skill_cloning.network import SkillCloningNetwork, SkillCloningSpec
from freerein_imitation.methods.skill_cloning.policy import SkillCloningPolicy
from freerein_imitation.methods.skills.network import SkillsNetwork, SkillsSpec
from freerein_imitation.methods.skills.policy import SkillsPolicy
from freerein_imitation.model.policy import CameraFrames, ControlSpec
from freerein_imitation.model.torch_policy import N

INPUTS: dict[str, Any] = {"cameras": (Camera("front", 24, 20, 3),), "action": ActionSpec(2, 0, ("dy", "dz"))}
GOALS = GoalConditionedSpec(**INPUTS, features=16, hidden_size=12)
GOAL_CLONING = GoalCloningSpec(**INPUTS, features=16, hidden_size=12)
SKILLS = SkillsSpec(**INPUTS, skills=("pick", "push"), hidden_size=16)
CLONED = SkillCloningSpec(
    **INPUTS, skills=("pick", "push"), features=16, hidden_size=12, memory=2, past_actions=1, chunk=3
)
DISCRETE: dict[str, Any] = {
    "cameras": (Camera("front", 24, 20, 1),),
    "action": ActionSpec(1, 4, ("up", "down", "left", "right")),
}
TWO: dict[str, Any] = {"cameras": (Camera("front", 24, 20, 3), Camera("wrist", 12, 16, 1))}
CONTROL = ControlSpec(0.04, 0.9, 30)


def images(spec: InputSpec, count: int, *, seed: int = 0) -> dict[str, npt.NDArray[np.uint8]]:
    rng = np.random.default_rng(seed)
    return {
        camera.name: rng.integers(0, 256, (count, camera.height, camera.width, camera.channels), np.uint8)
        for camera in spec.cameras
    }


def tensors(frames: CameraFrames) -> dict[str, torch.Tensor]:
    return {camera: torch.from_numpy(each) for camera, each in frames.items()}


def untrained(made: N, fit_normalisation: Callable[[FrameTensors, torch.Generator], None]) -> N:
    """Returns a network with weights and normalisation as before a fit, and an in-distribution score."""
    generator, frames = torch.Generator().manual_seed(0), tensors(images(made.spec, 8))
    weights.initialise(made, generator=generator)
    fit_normalisation(frames, generator)
    seen = image_statistics(frames)
    made.in_distribution.fit(seen, seen, torch.linspace(0.5, 1, 8), trajectories=8)
    return made


def goal_network(spec: GoalConditionedSpec) -> GoalConditionedNetwork:
    made = GoalConditionedNetwork(spec)
    return untrained(made, lambda frames, generator: made.fit_normalisation(frames, generator=generator))


def skills_network(spec: SkillsSpec) -> SkillsNetwork:
    made = SkillsNetwork(spec)
    return untrained(made, lambda frames, _generator: made.fit_normalisation(frames, torch.ones(1, spec.action.size)))


def cloned_network(spec: SkillCloningSpec) -> SkillCloningNetwork:
    made, actions = SkillCloningNetwork(spec), torch.linspace(-1, 1, 8)[:, None].repeat(1, spec.action.size)
    return untrained(made, lambda frames, generator: made.fit_normalisation(frames, actions, generator=generator))


def goal_cloning_network(spec: GoalCloningSpec) -> GoalCloningNetwork:
    made = GoalCloningNetwork(spec)
    return untrained(made, lambda frames, generator: made.encoder.fit_normalisation(frames, generator=generator))


@dataclass(frozen=True)
class Case:
    """A kind of policy with untrained weights.

    Attributes:
        spec: Spec of the network.
        make_network: Makes a network of a spec.
        make_policy: Makes a policy of a network and a control spec.
        method: Name of its method.
        goals: Returns `count` goals, different ones for different seeds.
    """

    spec: Any
    make_network: Callable[[Any], nn.Module]
    make_policy: Any
    method: str
    goals: Callable[[Any, int, int], Any]

    def network(self) -> Any:
        return self.make_network(self.spec)

    def policy(self) -> Any:
        return self.make_policy(self.network(), CONTROL)


def goal_images(spec: Any, count: int, seed: int) -> Any:
    return images(spec, count, seed=3 + seed)


def skill_names(spec: Any, count: int, seed: int) -> Any:
    return [spec.skills[(item + seed) % 2] for item in range(count)]


def goal_case(spec: GoalConditionedSpec) -> Case:
    return Case(spec, goal_network, GoalImagesPolicy, "goal_conditioned", goal_images)


def goal_cloning_case(spec: GoalCloningSpec) -> Case:
    return Case(spec, goal_cloning_network, GoalCloningPolicy, "goal_cloning", goal_images)


def skills_case(spec: SkillsSpec) -> Case:
    return Case(spec, skills_network, SkillsPolicy, "skills", skill_names)


def cloned_case(spec: SkillCloningSpec) -> Case:
    return Case(spec, cloned_network, SkillCloningPolicy, "skill_cloning", skill_names)


CASES = {
    "goals": goal_case(GOALS),
    "goals-discrete": goal_case(replace(GOALS, **DISCRETE)),
    "goals-two-cameras": goal_case(replace(GOALS, **TWO, encoder="convolutional", fusion="early")),
    "goal-cloning": goal_cloning_case(GOAL_CLONING),
    "goal-cloning-discrete": goal_cloning_case(replace(GOAL_CLONING, **DISCRETE)),
    "skills": skills_case(SKILLS),
    "skills-gripper": skills_case(replace(SKILLS, action=ActionSpec(3, 0, ("dy", "dz", "gripper")))),
    "cloned": cloned_case(CLONED),
    "cloned-discrete": cloned_case(replace(CLONED, **DISCRETE)),
    "cloned-principal": cloned_case(replace(CLONED, encoder="principal")),
    "cloned-robot-state": cloned_case(replace(CLONED, robot_state_size=3)),
    "cloned-one-frame": cloned_case(replace(CLONED, **TWO, memory=0, past_actions=0, chunk=1, ends="budget")),
}
ALL = pytest.mark.parametrize("case", CASES.values(), ids=CASES)
CONTINUOUS = pytest.mark.parametrize("case", [CASES[name] for name in ("goals", "skills", "cloned")])


def inputs(case: Case, policy: Any, count: int) -> list[Any]:
    """Returns frames, goals, no previous actions, random recurrent states, and the robot's where it is taken."""
    recurrent = np.random.default_rng(1).standard_normal((count, policy.spec.recurrent_size)).astype(np.float32)
    previous = np.repeat(policy.spec.action.no_action()[None], count, axis=0)
    state = np.random.default_rng(4).standard_normal((count, policy.spec.robot_state_size)).astype(np.float32)
    seen, goals = images(case.spec, count, seed=2), policy.encode_goals(case.goals(case.spec, count, 0))
    return [seen, goals, previous, recurrent, *([state] if state.size else [])]


def part(arrays: Any, rows: slice) -> Any:
    """Returns some rows of an array, or of each camera's."""
    return {camera: each[rows] for camera, each in arrays.items()} if isinstance(arrays, dict) else arrays[rows]


@ALL
def test_a_step_is_what_the_spec_says_and_alone_the_same_as_in_a_batch(case: Case) -> None:
    policy = case.policy()
    spec, choices = policy.spec, case.spec.action.choices
    frames, *arrays = inputs(case, policy, 3)
    for array in (*frames.values(), *arrays):
        array.flags.writeable = False
    output = policy.step(frames, *arrays)
    assert output.actions.shape == (3, spec.horizon, spec.action.size)
    assert output.actions.dtype == (np.int64 if choices else np.float32)
    assert output.actions.min() >= (0 if choices else -1)
    assert output.actions.max() <= (choices - 1 if choices else 1)
    assert output.recurrent.shape == (3, spec.recurrent_size)
    assert ((output.reached >= 0) & (output.reached <= 1)).all()
    assert (output.in_distribution.shape, output.in_distribution.dtype) == ((3,), np.float32)
    assert ((output.in_distribution >= 0) & (output.in_distribution <= 1)).all()
    for one in (slice(i, i + 1) for i in range(3)):
        alone = policy.step(*(part(array, one) for array in (frames, *arrays)))
        for name in ("actions", "reached", "recurrent", "in_distribution"):
            np.testing.assert_allclose(getattr(alone, name), getattr(output, name)[one], atol=1e-5)


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
    policy = GoalImagesPolicy(goal_network(spec), CONTROL)
    frame, goal, previous, recurrent = inputs(CASES["goals"], policy, 1)
    moved = policy.step(frame, goal, previous + 1, recurrent)
    np.testing.assert_array_equal(policy.step(frame, goal, previous, recurrent).actions, moved.actions)


def test_equal_calls_of_a_policy_that_samples_have_equal_actions_and_others_are_drawn_anew() -> None:
    spec = GoalConditionedSpec(**DISCRETE, features=16, hidden_size=12, temperature=1.0, recurrent=False)
    policy, frames = GoalImagesPolicy(goal_network(spec), CONTROL), images(spec, 4)
    assert policy.spec.draws == 1
    assert GoalImagesPolicy(goal_network(replace(spec, temperature=0.0)), CONTROL).spec.draws == 0
    goals = tuple(Subgoal(bytes([n]) * 16, {"front": frames["front"][n]}) for n in range(2))

    def request(step: int, seen: int = 2, goal: int = 0) -> InferenceRequest:
        state = PolicyState(np.zeros(0, np.float32), goal_steps=step)
        frame = {"front": frames["front"][seen]}
        previous = policy.spec.action.no_action()
        return InferenceRequest(policy, "0" * 12, goals[goal : goal + 1], frame, previous, state, 0, 10_000)

    def acted(*requests: InferenceRequest) -> list[int]:
        return [each.actions.item() for each in PolicyRunner().run_batch(requests)]  # type: ignore[union-attr]

    drawn = acted(*map(request, range(400)))
    assert drawn[:100] == [acted(request(step))[0] for step in range(100)]
    network = policy._network
    codes, goal = network(tensors({"front": frames["front"][[2, 0]]})).split(1)
    context, _ = network.policy.step(codes, goal, torch.tensor([[-1]]), torch.zeros(1, 0))
    expected = network.policy.action_head.distribution(network.policy.action_head.logits(context, context))[0]
    shares = np.bincount(drawn, minlength=4) / 400
    np.testing.assert_allclose(shares, expected.detach().numpy(), atol=0.08)
    for other in ({"seen": 3}, {"goal": 1}):
        assert acted(*(request(step, **other) for step in range(50))) != drawn[:50]


def test_an_unknown_skill_is_refused() -> None:
    with pytest.raises(InvalidInput, match="pick, push; 1 of 2"):
        CASES["skills"].policy().encode_goals(["pick", "fly"])


@ALL
def test_a_model_on_disk_acts_as_it_did(case: Case, tmp_path: Path) -> None:
    network = case.network()
    model_files.save_model(network, tmp_path, card={"method": case.method, **CONTROL.to_card()})
    before, after = case.make_policy(network, CONTROL), METHODS.load(tmp_path, "cpu")
    assert type(after) is type(before)
    assert after.spec == before.spec
    outputs = [each.step(*inputs(case, each, 2)) for each in (before, after)]
    np.testing.assert_array_equal(outputs[0].actions, outputs[1].actions)
    np.testing.assert_array_equal(outputs[0].reached, outputs[1].reached)
    np.testing.assert_array_equal(outputs[0].in_distribution, outputs[1].in_distribution)


def test_a_network_without_a_state_is_the_one_of_cards_that_do_not_know_of_it(tmp_path: Path) -> None:
    network = cloned_network(CLONED)
    model_files.save_model(network, tmp_path, card={"method": "skill_cloning", **CONTROL.to_card()})
    path = tmp_path / model_files.MODEL.card
    card = json.loads(path.read_text())
    assert card["spec"].pop("robot_state_size") == 0
    path.write_text(json.dumps(card))
    assert weights.sha256(model_files.load_model(tmp_path, SkillCloningSpec, SkillCloningNetwork, device="cpu")) == (
        weights.sha256(network)
    )
    assert not [name for name in network.state_dict() if "state" in name]


@pytest.mark.parametrize(
    ("case", "change"),
    [
        ("goals", {"method": "pilot"}),
        ("goals", {"method": None}),
        ("goals", {"control": {}}),
        ("goals", {"control": {"control_dt_s": "soon", "reached_threshold": 0.9, "max_steps_per_goal": 30}}),
        ("goals", {"spec": {}}),
        ("goals", {"spec": {"cameras": [], "action": {"size": 1, "choices": 0, "names": ["x"]}}}),
        ("skills", {"spec": {}}),
        ("skills", {"spec": {"skills": ["a"], "cameras": [{"name": "front"}]}}),
    ],
)
def test_a_malformed_card_is_refused(case: str, change: dict[str, object], tmp_path: Path) -> None:
    made = CASES[case]
    model_files.save_model(made.network(), tmp_path, card={"method": made.method, **CONTROL.to_card()})
    path = tmp_path / model_files.MODEL.card
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    with pytest.raises(InvalidInput):
        METHODS.load(tmp_path, "cpu")


@pytest.mark.parametrize("number", ["control_dt_s", "reached_threshold", "max_steps_per_goal"])
def test_a_control_spec_out_of_range_is_refused(number: str) -> None:
    card: Any = CONTROL.to_card()
    card["control"][number] = -1
    with pytest.raises(InvalidInput):
        ControlSpec.from_card(card)


def test_step_limits_are_those_of_skills_or_of_all_goals() -> None:
    network = skills_network(SKILLS)
    own = SkillsPolicy(network, replace(CONTROL, max_steps_per_skill=(5, 7))).spec
    assert [own.step_limit(goal) for goal in ("pick", "push", "wave", {})] == [5, 7, 30, 30]
    assert SkillsPolicy(network, CONTROL).spec.step_limit("pick") == 30
    with pytest.raises(InvalidInput, match="1 limits and 2 skills"):
        SkillsPolicy(network, replace(CONTROL, max_steps_per_skill=(5,)))
    with pytest.raises(InvalidInput):
        replace(CONTROL, max_steps_per_skill=(5, 0))


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
