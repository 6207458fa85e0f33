"""A batch of observations: each judged against its own goal, acted on alone, whatever it shares a batch with."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import pytest

from freerein.errors import OutputNotFinite
from freerein.types.common import ActionSpec
from freerein_imitation.acting import Answer, BatchActor, Item, Target
from freerein_imitation.memory import Memory

Floats = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Sum:
    actions: npt.NDArray[Any]
    reached: Floats
    memory: Floats


class Summing:
    """Skills that end when the frame is as bright as their name is long; the memory adds up the frames seen."""

    kind: Literal["skills"] = "skills"
    camera, height, width, channels = "front", 1, 1, 1
    action, action_size, action_choices = ActionSpec(1, 0, ("x",)), 1, 0
    horizon, control_dt_s, memory_size = 2, 0.1, 2
    skills: tuple[str, ...] = ("a", "bb", "ccc")
    reached_threshold, max_steps_per_goal = 0.5, 3

    def __init__(self) -> None:
        self.encoded: list[list[str]] = []
        self.batches: list[int] = []

    def encode_goals(self, goals: Sequence[str]) -> Floats:
        self.encoded.append(list(goals))
        return np.array([[len(goal)] for goal in goals], np.float32)

    def step(self, frames: npt.NDArray[np.uint8], goals: Floats, previous: Floats, memory: Floats) -> Sum:
        self.batches.append(len(frames))
        bright = frames[:, 0, 0, 0].astype(np.float32)
        after = memory + np.stack([bright, previous[:, 0]], axis=1)
        after[bright == 255] = np.nan
        reached = (bright == goals[:, 0]).astype(np.float32)
        return Sum((0.1 * goals + 0 * after[:, :1])[:, None].repeat(2, axis=1), reached, after)


def targets(*names: str) -> tuple[Target, ...]:
    return tuple(Target(name.encode(), name) for name in names)


def item(policy: Summing, bright: int, *names: str, memory: Memory | None = None, elapsed: int = 1) -> Item:
    return Item(
        policy=policy,
        version="v",
        targets=targets(*names or ("a", "bb")),
        frame=np.full((1, 1, 1), bright, np.uint8),
        previous=np.zeros(1, np.float32),
        memory=memory or Memory(np.zeros(2, np.float32)),
        elapsed=elapsed,
        max_steps=policy.max_steps_per_goal,
    )


def act(batch: Sequence[Item], actor: BatchActor | None = None) -> list[Answer]:
    answers = (actor or BatchActor()).act_batch(batch)
    assert all(isinstance(answer, Answer) for answer in answers)
    return answers  # type: ignore[return-value]


def test_an_observation_that_is_not_at_its_goal_is_remembered_and_acted_on() -> None:
    (answer,) = act([item(Summing(), 7)])
    np.testing.assert_allclose(answer.actions, [[0.1], [0.1]])
    assert (answer.reached, answer.confidence, answer.memory.goal_index, answer.memory.steps) == (False, 0.0, 0, 1)
    assert answer.memory.hidden.tolist() == [7, 0]


def test_at_a_goal_the_memory_is_emptied_and_the_same_observation_is_acted_on_for_the_next() -> None:
    policy = Summing()
    (answer,) = act([item(policy, 1, memory=Memory(np.array([9, 9], np.float32), steps=2))])
    np.testing.assert_allclose(answer.actions, [[0.2], [0.2]])
    assert (answer.reached, answer.confidence, answer.memory.goal_index, answer.memory.steps) == (False, 1.0, 1, 0)
    assert answer.memory.hidden.tolist() == [1, 0]
    assert policy.batches == [1, 1]


def test_at_the_last_goal_there_is_nothing_to_do_and_it_stays_so() -> None:
    (answer,) = act([item(Summing(), 2, memory=Memory(np.zeros(2, np.float32), goal_index=1))])
    assert answer.actions.shape == (0, 1)
    assert (answer.reached, answer.memory.goal_index) == (True, 2)
    (later,) = act([item(Summing(), 77, memory=answer.memory)])
    assert later.actions.shape == (0, 1)
    assert (later.reached, later.confidence, later.memory.goal_index) == (True, 0.0, 2)


def test_a_goal_that_takes_too_long_is_given_up_and_then_not_all_are_reached() -> None:
    memory = Memory(np.zeros(2, np.float32))
    indices = []
    for _ in range(7):
        (answer,) = act([item(Summing(), 9, memory=memory, elapsed=int(bool(indices)))])
        memory = answer.memory
        indices.append(memory.goal_index)
    assert indices == [0, 0, 0, 1, 1, 1, 2]  # three control steps each
    assert memory.abandoned
    assert not answer.reached
    assert answer.actions.shape == (0, 1)


def test_time_passes_by_what_was_executed() -> None:
    (answer,) = act([item(Summing(), 9, elapsed=3)])
    assert (answer.memory.goal_index, answer.memory.abandoned) == (1, True)


def test_a_goal_reached_at_the_last_moment_is_reached() -> None:
    (answer,) = act([item(Summing(), 1, elapsed=3)])
    assert (answer.memory.goal_index, answer.memory.abandoned) == (1, False)


@pytest.mark.fault("I14")
def test_an_output_that_is_not_finite_fails_alone() -> None:
    policy = Summing()
    answers = BatchActor().act_batch([item(policy, 7), item(policy, 255), item(policy, 1)])
    assert isinstance(answers[1], OutputNotFinite)
    alone = act([item(policy, 7), item(policy, 1)])
    for answer, expected in zip((answers[0], answers[2]), alone, strict=True):
        assert isinstance(answer, Answer)
        np.testing.assert_array_equal(answer.actions, expected.actions)


def test_a_goal_is_encoded_once_for_each_version() -> None:
    policy, actor = Summing(), BatchActor()
    act([item(policy, 7), item(policy, 8), item(policy, 9, "bb")], actor)
    act([item(policy, 7), replace(item(policy, 7), version="w")], actor)
    assert policy.encoded == [["a", "bb"], ["a"]]


def test_codes_are_remembered_within_a_bound() -> None:
    policy, actor = Summing(), BatchActor(codes_bytes=8)
    for name in ("a", "bb", "a", "ccc", "bb"):
        act([item(policy, 7, name)], actor)
    assert policy.encoded == [["a"], ["bb"], ["ccc"], ["bb"]]
    act([item(policy, 7, name) for name in ("a", "bb", "ccc")], actor)


def test_a_policy_that_answers_in_another_shape_is_at_fault() -> None:
    policy = Summing()
    policy.horizon = 3
    with pytest.raises(ValueError, match="due"):
        BatchActor().act_batch([item(policy, 7)])
