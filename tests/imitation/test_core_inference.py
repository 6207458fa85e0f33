"""A batch of observations: each result depends on its own goal and state only, whatever it shares a batch with."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from freerein.errors import OutputNotFinite
from freerein.types.common import ActionSpec, Camera
from freerein_imitation.core.inference import InferenceRequest, InferenceResult, PolicyRunner
from freerein_imitation.core.inputs import Subgoal
from freerein_imitation.core.policy_state import PolicyState
from freerein_imitation.model.policy import CameraFrames, Policy, PolicyOutput, PolicySpec

Floats = npt.NDArray[np.float32]


class Summing(Policy):
    """Skills that end when the frame is as bright as their name is long; the recurrent state sums up the frames."""

    def __init__(self, *, horizon: int = 2, **fields: Any) -> None:
        self.spec = PolicySpec(
            action=ActionSpec(1, 0, ("x",)),
            control_dt_s=0.1,
            reached_threshold=0.5,
            max_steps_per_goal=3,
            goal_form="recipe",
            cameras=(Camera("front", 1, 1, 1),),
            horizon=horizon,
            skills=("a", "bb", "ccc"),
            recurrent_size=2,
            **fields,
        )
        self.encoded: list[list[str]] = []
        self.batches: list[int] = []
        self.skipped: list[list[int]] = []
        self.scored: int | None = None

    def skip_steps(self, recurrent: Floats, steps: npt.NDArray[np.int64]) -> Floats:
        self.skipped.append(steps.tolist())
        return recurrent

    def encode_goals(self, goals: Sequence[str]) -> Floats:
        self.encoded.append(list(goals))
        return np.array([[len(goal)] for goal in goals], np.float32)

    def step(
        self, frames: CameraFrames, goals: Floats, previous: Floats, recurrent: Floats, _robot_state: None = None
    ) -> PolicyOutput:
        bright = frames["front"][:, 0, 0, 0].astype(np.float32)
        self.batches.append(len(bright))
        after = recurrent + np.stack([bright, previous[:, 0]], axis=1)
        after[bright == 255] = np.nan
        familiar = 1 / (1 + bright + recurrent[:, 0])
        familiar[bright == 254] = np.nan
        reached = (bright == goals[:, 0]).astype(np.float32)
        actions = (0.1 * goals + 0 * after[:, :1])[:, None].repeat(2, axis=1)
        return PolicyOutput(actions, reached, after, familiar[: self.scored])


class Remembering(Summing):
    """Its state's second number is of the goal."""

    def reset_goal_state(self, recurrent: Floats) -> Floats:
        return recurrent * np.array([1, 0], np.float32)


def item(
    policy: Summing, bright: int, *names: str, state: PolicyState | None = None, elapsed: int = 1
) -> InferenceRequest:
    return InferenceRequest(
        policy=policy,
        version="v",
        goals=tuple(Subgoal(name.encode(), name) for name in names or ("a", "bb")),
        frames={"front": np.full((1, 1, 1), bright, np.uint8)},
        previous=np.zeros(1, np.float32),
        state=state or PolicyState(np.zeros(2, np.float32)),
        elapsed=elapsed,
        max_steps=policy.spec.max_steps_per_goal,
    )


def run(batch: Sequence[InferenceRequest], runner: PolicyRunner | None = None) -> list[InferenceResult]:
    results = (runner or PolicyRunner()).run_batch(batch)
    assert all(isinstance(result, InferenceResult) for result in results)
    return results  # type: ignore[return-value]


def test_an_observation_that_is_not_at_its_goal_is_remembered_and_acted_on() -> None:
    (result,) = run([item(Summing(), 7)])
    np.testing.assert_allclose(result.actions, [[0.1], [0.1]])
    assert (result.reached, result.confidence, result.state.goal_index, result.state.goal_steps) == (False, 0.0, 0, 1)
    assert result.state.recurrent.tolist() == [7, 0]


def test_at_a_goal_the_recurrent_state_is_reset_and_the_same_observation_is_acted_on_for_the_next() -> None:
    policy = Summing()
    (result,) = run([item(policy, 1, state=PolicyState(np.array([9, 9], np.float32), goal_steps=2))])
    np.testing.assert_allclose(result.actions, [[0.2], [0.2]])
    assert result.in_distribution == pytest.approx(1 / 11)  # of the goal that was current, as the confidence
    assert (result.reached, result.confidence, result.state.goal_index, result.state.goal_steps) == (False, 1.0, 1, 0)
    assert result.state.recurrent.tolist() == [1, 0]
    assert policy.batches == [1, 1]


def test_what_outlasts_goals_is_handed_on_and_takes_in_each_observation_once() -> None:
    state = PolicyState(np.array([9, 8], np.float32), goal_steps=2)
    (result,) = run([item(Remembering(), 1, state=state)])
    assert (result.state.goal_index, result.state.goal_steps) == (1, 0)
    assert result.state.recurrent.tolist() == [10, 0]


def test_at_the_last_goal_there_is_nothing_to_do_and_it_stays_so() -> None:
    (result,) = run([item(Summing(), 2, state=PolicyState(np.zeros(2, np.float32), goal_index=1))])
    assert result.actions.shape == (0, 1)
    assert (result.reached, result.state.goal_index) == (True, 2)
    (later,) = run([item(Summing(), 77, state=result.state)])
    assert later.actions.shape == (0, 1)
    assert (later.reached, later.confidence, later.state.goal_index) == (True, 0.0, 2)


def test_a_goal_that_takes_too_long_is_given_up_and_then_not_all_are_reached() -> None:
    state = PolicyState(np.zeros(2, np.float32))
    indices = []
    for _ in range(7):
        (result,) = run([item(Summing(), 9, state=state, elapsed=int(bool(indices)))])
        state = result.state
        indices.append(state.goal_index)
    assert indices == [0, 0, 0, 1, 1, 1, 2]  # three control steps each
    assert state.abandoned
    assert not result.reached
    assert result.actions.shape == (0, 1)


def test_time_passes_by_what_was_executed() -> None:
    (result,) = run([item(Summing(), 9, elapsed=3)])
    assert (result.state.goal_index, result.state.abandoned) == (1, True)


def test_a_policy_is_told_of_control_steps_without_an_observation() -> None:
    policy = Summing()
    run([item(policy, 9, elapsed=0), item(policy, 9)])
    run([item(policy, 9), item(policy, 1, elapsed=2)])
    assert policy.skipped == [[0, 1], [1]]  # the second is at its goal, and acts for the next


def test_a_goal_reached_at_the_last_moment_is_reached() -> None:
    (result,) = run([item(Summing(), 1, elapsed=3)])
    assert (result.state.goal_index, result.state.abandoned) == (1, False)


@pytest.mark.fault("I14")
@pytest.mark.parametrize("bright", [254, 255])
def test_an_output_that_is_not_finite_fails_alone(bright: int) -> None:
    policy = Summing()
    results = PolicyRunner().run_batch([item(policy, 7), item(policy, bright), item(policy, 1)])
    assert isinstance(results[1], OutputNotFinite)
    alone = run([item(policy, 7), item(policy, 1)])
    for result, expected in zip((results[0], results[2]), alone, strict=True):
        assert isinstance(result, InferenceResult)
        np.testing.assert_array_equal(result.actions, expected.actions)


def test_a_goal_is_encoded_once_for_each_version() -> None:
    policy, runner = Summing(), PolicyRunner()
    run([item(policy, 7), item(policy, 8), item(policy, 9, "bb")], runner)
    run([item(policy, 7), replace(item(policy, 7), version="w")], runner)
    assert policy.encoded == [["a"], ["bb"], ["a"]]


class Blank(Summing):
    """Knows a single goal, so that embeddings are empty."""

    def encode_goals(self, goals: Sequence[str]) -> Floats:
        return super().encode_goals(goals)[:, :0]

    def step(
        self, frames: CameraFrames, goals: Floats, previous: Floats, recurrent: Floats, _robot_state: None = None
    ) -> PolicyOutput:
        return super().step(frames, np.ones((len(goals), 1), np.float32), previous, recurrent)


@pytest.mark.parametrize("make", [Summing, Blank])
def test_the_cache_of_goal_embeddings_is_bounded(make: type[Summing]) -> None:
    policy, runner = make(), PolicyRunner(cache_bytes=1200)  # two entries
    for name in ("a", "bb", "a", "ccc", "bb"):
        run([item(policy, 7, name)], runner)
    assert policy.encoded == [["a"], ["bb"], ["ccc"], ["bb"]]
    run([item(policy, 7, name) for name in ("a", "bb", "ccc")], runner)


def test_a_policy_that_answers_in_another_shape_is_at_fault() -> None:
    for policy, scored in ((Summing(horizon=3), None), (Summing(), 0)):
        policy.scored = scored
        with pytest.raises(ValueError, match="must have shapes"):
            PolicyRunner().run_batch([item(policy, 7)])
