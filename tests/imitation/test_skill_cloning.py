"""Skill cloning in a world whose frames do not tell velocities: a light that is pushed to one end or the other."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import pytest
import torch

from freerein.errors import InvalidInput
from freerein.learning.training_loop import fit
from freerein.learning.trajectories import Trajectories
from freerein.types.common import ActionSpec, Camera
from freerein_imitation.core.inference import InferenceRequest, InferenceResult, PolicyRunner
from freerein_imitation.core.inputs import Subgoal
from freerein_imitation.core.policy_state import PolicyState
from freerein_imitation.methods.shared.skill_segments import SkillSegment, find_segments, keep_tagged
from freerein_imitation.methods.skill_cloning.config import SkillCloningConfig, network_spec
from freerein_imitation.methods.skill_cloning.losses import SkillCloningLearner
from freerein_imitation.methods.skill_cloning.memory import Memory, MemorySizes
from freerein_imitation.methods.skill_cloning.network import SkillCloningSpec
from freerein_imitation.methods.skill_cloning.policy import SkillCloningPolicy
from freerein_imitation.methods.skill_cloning.spans import SkillTimes, Spans
from freerein_imitation.model.policy import ControlSpec

SKILLS = ("left", "right")
ENDS = (4.0, 19.0)
WIDTH = 24
CAMERAS = (Camera("front", 4, WIDTH, 1),)
ACTION = ActionSpec(1, 0, ("force",))
FAST = SkillCloningConfig(
    steps=400,
    batch_size=8,
    span=12,
    lr=5e-3,
    encoder="moments",
    features=40,
    hidden_size=32,
    shift=0,
    chunk=3,
    termination_steps=1,
    evaluate_every=200,
)


@dataclass
class Light:
    """A light at a place, with a velocity; a force of 1 accelerates it by 1 pixel per timestep."""

    place: float
    velocity: float = 0.0

    def picture(self) -> npt.NDArray[np.uint8]:
        share = np.exp(-((np.arange(WIDTH) - self.place) ** 2) / 4)
        return np.round(200 * share).astype(np.uint8)[None, :, None].repeat(4, axis=0)

    def expert(self, skill: int) -> float:
        """Returns the force of a critically damped spring towards the skill's end."""
        return float(np.clip(0.1 * (ENDS[skill] - self.place) - 0.6 * self.velocity, -1, 1))

    def is_there(self, skill: int) -> bool:
        return abs(self.place - ENDS[skill]) < 1.5 and abs(self.velocity) < 0.5

    def step(self, force: float) -> None:
        self.velocity += force
        self.place += self.velocity


def demonstrate(count: int, *, seed: int) -> tuple[Trajectories, list[npt.NDArray[np.int64]]]:
    """Returns trajectories of one or two skills with noisy forces, and which skill that is."""
    rng = np.random.default_rng(seed)
    frames, actions, labels = [], [], []
    for _ in range(count):
        light, seen, done, told = Light(rng.uniform(3, 20)), [], [], []
        for skill in rng.permutation(2)[: rng.integers(1, 3)].tolist():
            for _ in range(40):
                force = float(np.clip(light.expert(skill) + rng.normal(0, 0.3), -1, 1))
                seen.append(light.picture())
                done.append([force])
                told.append(skill)
                if light.is_there(skill):
                    break
                light.step(force)
        frames.append(np.array(seen))
        actions.append(np.array(done, np.float32))
        labels.append(np.array(told, np.int64))
    return Trajectories({"front": frames}, actions), labels


def prepare(
    demonstrations: Trajectories,
    labels: Sequence[npt.NDArray[np.int64]],
    config: SkillCloningConfig = FAST,
    skills: tuple[str, ...] = SKILLS,
) -> SkillCloningLearner:
    spec = network_spec(config, cameras=CAMERAS, action=ACTION, skills=skills)
    return SkillCloningLearner.prepare(
        config, spec, demonstrations, labels, fingerprint="f", device=torch.device("cpu")
    )


def control(learner: SkillCloningLearner, threshold: float) -> ControlSpec:
    limits = learner.step_limits()
    return ControlSpec(0.1, threshold, max(limits), max_steps_per_skill=limits)


@pytest.fixture(scope="module")
def policy(tmp_path_factory: pytest.TempPathFactory) -> SkillCloningPolicy:
    learner = prepare(*demonstrate(100, seed=0))
    fitted = fit(learner, tmp_path_factory.mktemp("fit"))
    assert fitted is not None
    learner.calibrate(fitted.network)
    return SkillCloningPolicy(fitted.network, control(learner, learner.termination_threshold(fitted.network)))


def observe(
    policy: SkillCloningPolicy, light: Light, recipe: Sequence[str], state: PolicyState, *, elapsed: int = 1
) -> InferenceResult:
    """Returns what the service's core answers to a frame, some control steps after the last."""
    goals = tuple(Subgoal(name.encode(), name) for name in recipe)
    request = InferenceRequest(
        policy=policy,
        version="v",
        goals=goals,
        frames={"front": light.picture()},
        previous=np.zeros(1, np.float32),
        state=state,
        elapsed=elapsed,
        max_steps=policy.spec.step_limit(recipe[min(state.goal_index, len(recipe) - 1)]),
    )
    (result,) = PolicyRunner().run_batch([request])
    assert isinstance(result, InferenceResult)
    return result


def start(policy: SkillCloningPolicy) -> PolicyState:
    return PolicyState(np.zeros(policy.spec.recurrent_size, np.float32))


def test_recipes_longer_than_any_demonstration_are_executed_and_the_end_head_goes_on_to_the_next_skill(
    policy: SkillCloningPolicy,
) -> None:
    recipe, state, light, switches = ("right", "left", "right", "left"), start(policy), Light(10.0), []
    for _ in range(200):
        result = observe(policy, light, recipe, state)
        switches += [light.place] * (result.state.goal_index - state.goal_index)
        state = result.state
        if not len(result.actions):
            break
        light.step(float(result.actions[0, 0]))
    assert (state.goal_index, state.abandoned) == (4, False)
    np.testing.assert_allclose(switches, [ENDS[SKILLS.index(skill)] for skill in recipe], atol=2.5)


@pytest.mark.parametrize("executed", [2, 3])
def test_a_robot_that_executes_several_actions_of_a_chunk_is_moved_as_far(
    policy: SkillCloningPolicy, executed: int
) -> None:
    state, light = start(policy), Light(6.0)
    for _ in range(24 // executed):
        result = observe(policy, light, ("right",), state, elapsed=executed)
        state = result.state
        for action in result.actions[:executed]:
            light.step(float(action[0]))
    assert abs(light.place - ENDS[1]) < 2
    assert abs(light.velocity) < 0.5


def test_a_budget_goes_on_to_the_next_skill_after_as_many_steps_as_three_quarters_of_the_segments_have() -> None:
    learner = prepare(*demonstrate(20, seed=1), config=replace(FAST, ends="budget"))
    network = learner.init(torch.Generator().manual_seed(0)).network
    policy, limits = SkillCloningPolicy(network, control(learner, 1.0)), learner.step_limits()
    lengths = [each.stop - each.start for each in learner.segments if each.skill == 0]
    assert 0.7 < np.mean(np.array(lengths) <= limits[0]) <= 1
    state, light, indices = start(policy), Light(10.0), []
    for _ in range(sum(limits)):
        result = observe(policy, light, SKILLS, state)
        state = result.state
        indices.append(state.goal_index)
    assert indices == [0] * (limits[0] - 1) + [1] * limits[1] + [2]
    assert (result.reached, result.confidence) == (None, 0.0)


def test_velocity_is_known_from_earlier_frames_and_outlasts_a_skill(policy: SkillCloningPolicy) -> None:
    forces = []
    for velocity in (-1.5, 1.5):
        result = observe(policy, Light(12.0 - velocity), ("right", "left"), start(policy))
        moved_on = replace(result.state, goal_index=1)
        forces.append(observe(policy, Light(12.0, velocity), ("right", "left"), moved_on).actions[0, 0])
    assert forces[0] - forces[1] > 0.5


def test_an_evaluation_encodes_no_more_frames_at_once_than_an_update() -> None:
    learner = prepare(*demonstrate(20, seed=1), config=replace(FAST, batch_size=2))
    network, at_once = learner.init(torch.Generator().manual_seed(0)).network, []
    network.encoder.register_forward_pre_hook(lambda _, args: at_once.append(len(args[0]["front"])))
    losses, threshold = learner.validation_losses(network), learner.termination_threshold(network)
    assert max(at_once) == 2 * (FAST.memory + FAST.span)
    whole = replace(learner, config=replace(FAST, batch_size=1000))
    torch.testing.assert_close(whole.validation_losses(network), losses)
    assert whole.termination_threshold(network) == threshold


def test_timesteps_without_a_label_are_left_out() -> None:
    demonstrations, labels = demonstrate(8, seed=2)
    for each in labels:
        each[3:6] = -1
    learner = prepare(demonstrations, labels, replace(FAST, min_segment_steps=1))
    rejected = {(item, step) for item in range(8) for step in (3, 4, 5)}
    assert rejected.isdisjoint(map(tuple, learner.items.tolist()))
    batch = learner.spans.read(np.array([0]), np.array([0]), 8)
    assert batch.skill[0, 3:6].tolist() == [-1, -1, -1]
    assert batch.is_own[0].sum(axis=1)[:7].tolist() == [3, 2, 1, 0, 0, 0, 3]


def test_segments_are_runs_of_a_label_that_the_trajectory_is_tagged_with() -> None:
    found = find_segments([np.array([0, 0, -1, -1, 1, 1, 1, 0]), np.array([1, 1, -1])], min_steps=2)
    assert found == [SkillSegment(0, 0, 2, 0), SkillSegment(0, 4, 7, 1), SkillSegment(1, 0, 2, 1)]
    assert keep_tagged(found, [("right",), ("left",)], skills=SKILLS) == found[1:2]
    assert keep_tagged(found, [(), ()], skills=SKILLS) == keep_tagged(found, (), skills=SKILLS) == found


def test_a_skill_does_not_end_at_a_flicker() -> None:
    flickers = [np.array([0, 0, 0, -1, -1, 0, 0, 0, 1, 0, 0, 0]), np.array([0, 0, 0, -1, -1, -1, 0, 0, 0])]
    found = find_segments(flickers, min_steps=3)
    assert found == [SkillSegment(0, 0, 12, 0), SkillSegment(1, 0, 3, 0), SkillSegment(1, 6, 9, 0)]


def test_a_span_tells_what_was_seen_done_and_over_at_each_timestep() -> None:
    frames = np.arange(6, dtype=np.uint8)[:, None, None, None]
    actions = np.arange(6, dtype=np.float32)[:, None] / 10
    times = SkillTimes.of([SkillSegment(0, 0, 2, 1), SkillSegment(0, 2, 6, 0)], 6, steps_after=2)
    spans = Spans(Trajectories({"front": [frames]}, [actions]), [times], np.zeros(1, np.float32), 1, 2, 2)
    batch = spans.read(np.array([0]), np.array([1]), 6)
    assert batch.frames["front"].flatten().tolist() == [0, 1, 2, 3, 4, 5, 5]
    assert batch.skill.tolist() == [[1, 0, 0, 0, 0, -1]]
    assert batch.terminates.tolist() == [[True, False, False, False, True, False]]
    assert batch.ended.tolist() == [[-1, 1, 1, -1, -1, -1]]
    np.testing.assert_allclose(batch.executed[0, :2, :, 0], [[0, 0], [0.1, 0]])
    np.testing.assert_allclose(batch.actions[0, :2, :, 0], [[0.1, 0.2], [0.2, 0.3]])
    assert batch.is_own[0, :2].tolist() == [[True, False], [True, True]]
    assert not spans.read(np.array([0]), np.array([0]), 1).is_known.any()


# --- memory

SIZES = MemorySizes(frames=2, features=3, actions=1, action_size=1, chunk=2, outputs=1)
COUNTING = MemorySizes(frames=2, features=1, actions=2, action_size=1, chunk=5, outputs=1)
NO_ACTION = torch.full((1,), -1.0)


def memory_of(flat: torch.Tensor, sizes: MemorySizes) -> Memory:
    """Returns the memory in a flat vector; it begins with actions of -1."""
    return Memory.parse(flat, sizes, no_action=NO_ACTION)


def test_before_an_episode_no_action_was_executed() -> None:
    memory = memory_of(torch.zeros(1, COUNTING.total), COUNTING).with_action(torch.ones(1, 1))
    assert memory.actions.flatten().tolist() == [1, -1]
    later, _ = predicting(memory, 0)
    assert memory_of(later.flat(), COUNTING).actions.flatten().tolist() == [1, -1]


def test_a_memory_survives_being_flat_and_forgets_what_it_predicted_of_another_skill_or_of_the_same_before() -> None:
    memory = memory_of(torch.zeros(1, SIZES.total), SIZES)
    memory, first = memory.advanced(
        torch.ones(1, 3), torch.tensor([1]), torch.tensor([[[1.0], [2.0]]]), torch.tensor([0.8])
    )
    memory = memory_of(memory.flat(), SIZES)
    assert memory.rates.tolist() == [[1, 0]]
    same_skill, same = memory.advanced(
        torch.ones(1, 3), torch.tensor([1]), torch.tensor([[[4.0], [5.0]]]), torch.tensor([0.6])
    )
    other_skill, other = memory.advanced(
        torch.ones(1, 3), torch.tensor([0]), torch.tensor([[[4.0], [5.0]]]), torch.tensor([0.6])
    )
    same_again, again = memory.without_skill().advanced(
        torch.ones(1, 3), torch.tensor([1]), torch.tensor([[[4.0], [5.0]]]), torch.tensor([0.6])
    )
    assert first.flatten().tolist() == [1, 2]
    assert same.flatten().tolist() == pytest.approx([(0.7 * 2 + 4) / 1.7, 5])
    assert other.flatten().tolist() == again.flatten().tolist() == [4, 5]
    ends = [each.ended.item() for each in (memory, same_skill, other_skill, same_again)]
    assert ends == pytest.approx([0.4, 0.5, 0.3, 0.3])
    assert same_again.rates.tolist() == [[1, 1]]


def predicting(memory: Memory, first: int) -> tuple[Memory, list[float]]:
    """Returns the memory after a frame whose predictions are their own timesteps, and the averaged ones."""
    chunk = torch.arange(first, first + COUNTING.chunk).float()[None, :, None]
    later, averaged = memory.advanced(torch.full((1, 1), float(first)), torch.tensor([0]), chunk, torch.zeros(1))
    return later, averaged.flatten().tolist()


@pytest.mark.parametrize("executed", range(1, 8))
def test_predictions_are_for_their_own_timesteps_however_many_actions_were_executed(executed: int) -> None:
    memory, none = memory_of(torch.zeros(1, COUNTING.total), COUNTING), NO_ACTION
    for first in range(0, 4 * executed, executed):
        memory, averaged = predicting(memory, first)
        assert averaged == pytest.approx(range(first, first + COUNTING.chunk))
        memory = memory.skipped(torch.tensor([executed - 1]), no_action=none)


def test_timesteps_are_skipped_together_as_one_by_one_and_each_memory_for_itself() -> None:
    memory, none = memory_of(torch.zeros(1, COUNTING.total), COUNTING), NO_ACTION
    for first in range(3):
        memory, _ = predicting(memory.with_action(torch.full((1, 1), float(first))), first)
    one_by_one = [memory]
    for _ in range(6):
        one_by_one.append(one_by_one[-1].skipped(torch.tensor([1]), no_action=none))
    batch = memory_of(memory.flat().repeat(7, 1), COUNTING).skipped(torch.arange(7), no_action=none)
    torch.testing.assert_close(batch.flat(), torch.cat([each.flat() for each in one_by_one]))
    assert torch.equal(batch.flat()[:1], memory.flat())
    assert batch.rates[2].tolist() == pytest.approx([1 / 3, 1])
    assert [each.tolist() for each in batch.actions[:2, :, 0]] == [[2, 1], [-1, -1]]


def test_any_finite_state_gives_finite_actions_in_range(policy: SkillCloningPolicy) -> None:
    rng = np.random.default_rng(0)
    for scale in (1.0, 1e4):
        hostile = (scale * rng.standard_normal(policy.spec.recurrent_size)).astype(np.float32)
        result = observe(policy, Light(9.0), SKILLS, PolicyState(hostile))
        assert np.isfinite(result.actions).all()
        assert np.abs(result.actions).max() <= 1


def test_a_memory_that_does_not_fit_into_a_state_is_refused() -> None:
    with pytest.raises(InvalidInput, match="at most 16000 numbers; got 16404") as error:
        SkillCloningSpec(cameras=CAMERAS, action=ACTION, skills=SKILLS, features=1024, memory=16, chunk=1)
    assert error.value.field == "config.memory"
