"""A memory goes out as a state and comes back; whatever else is sent in its place is refused."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from freerein.errors import FailedPrecondition, InvalidInput
from freerein_imitation import memory as memories
from freerein_imitation.memory import Memory
from freerein_imitation.model import GoalConditionedSpec, SkillsSpec

VERSION, OTHER = "0123456789ab", "ba9876543210"
GOAL = bytes(range(16))
MAX_STATE_BYTES = 64 * 1024
MEMORY = Memory(np.array([0.5, -1.5, 3e38], np.float32), goal_index=2, steps=41, abandoned=True)
STATE = memories.save(MEMORY, version=VERSION, goal=GOAL)


def load(state: bytes, *, version: str = VERSION, goal: bytes = GOAL, goals: int = 3, size: int = 3) -> Memory:
    return memories.load(state, version=version, goal=goal, goals=goals, size=size)


def test_a_memory_comes_back_as_it_went() -> None:
    back = load(STATE)
    assert (back.goal_index, back.steps, back.abandoned) == (2, 41, True)
    assert back.hidden.tobytes() == MEMORY.hidden.tobytes()


@pytest.mark.parametrize(
    ("spec", "units"),
    [(GoalConditionedSpec(camera="front"), "hidden"), (SkillsSpec(skills=("pick",), camera="front"), "memory")],
)
def test_a_policy_whose_state_would_be_longer_than_64_kib_cannot_be_made(spec: Any, units: str) -> None:
    empty = memories.save(Memory(np.zeros(0, np.float32)), version=VERSION, goal=GOAL)
    floats = (MAX_STATE_BYTES - len(empty)) // 4
    with pytest.raises(InvalidInput):
        replace(spec, **{units: floats // 2 + 1})  # hidden state and cell


def test_the_state_of_another_model_or_goal_says_what_to_do() -> None:
    with pytest.raises(FailedPrecondition, match=VERSION) as other_model:
        load(STATE, version=OTHER)
    assert "model" in other_model.value.hint
    with pytest.raises(FailedPrecondition, match="goal"):
        load(STATE, goal=GOAL[::-1])


@pytest.mark.fault("I1")
@pytest.mark.parametrize(
    "state",
    [
        STATE[:-1],
        STATE + b"\0",
        STATE[:20],
        b"x" + STATE[1:],
        STATE[:-4] + np.float32("nan").tobytes(),
        STATE[:-4] + np.float32("inf").tobytes(),
        memories.save(Memory(MEMORY.hidden, goal_index=4), version=VERSION, goal=GOAL),
        bytes(MAX_STATE_BYTES),
    ],
)
def test_a_damaged_state_is_refused(state: bytes) -> None:
    with pytest.raises(InvalidInput) as error:
        load(state)
    assert error.value.field == "state"


@given(at=st.integers(0, len(STATE) - 1), flip=st.integers(1, 255))
def test_a_changed_byte_is_refused_or_a_memory_within_bounds(at: int, flip: int) -> None:
    changed = STATE[:at] + bytes([STATE[at] ^ flip]) + STATE[at + 1 :]
    try:
        memory = load(changed)
    except (InvalidInput, FailedPrecondition):
        return
    assert 0 <= memory.goal_index <= 3
    assert np.isfinite(memory.hidden).all()


@given(state=st.binary(max_size=200))
def test_any_bytes_are_refused(state: bytes) -> None:
    with pytest.raises(InvalidInput):
        load(state)
