"""A policy state survives its encoding; anything else sent as `state` is refused."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from freerein.errors import FailedPrecondition, InvalidInput
from freerein.types.common import ActionSpec, Camera
from freerein_imitation.core.policy_state import PolicyState, decode_state, encode_state
from freerein_imitation.methods.goal_conditioned.network import GoalConditionedSpec

INPUTS: dict[str, Any] = {"cameras": (Camera("front", 64, 64, 3),), "action": ActionSpec(1, 0, ("x",))}
VERSION, OTHER = "0123456789ab", "ba9876543210"
GOAL = bytes(range(16))
MAX_STATE_BYTES = 64 * 1024
STATE = PolicyState(np.array([0.5, -1.5, 3e38], np.float32), goal_index=2, goal_steps=41, abandoned=True)
ENCODED = encode_state(STATE, version=VERSION, goal_digest=GOAL)


def decode(data: bytes, *, version: str = VERSION, goal: bytes = GOAL) -> PolicyState:
    return decode_state(data, version=version, goal_digest=goal, goals=3, size=3)


def test_a_state_survives_its_encoding() -> None:
    decoded = decode(ENCODED)
    assert (decoded.goal_index, decoded.goal_steps, decoded.abandoned) == (2, 41, True)
    assert decoded.recurrent.tobytes() == STATE.recurrent.tobytes()


def test_pixels_of_earlier_frames_have_a_byte_each() -> None:
    pixels = np.arange(256, dtype=np.float32)
    state = PolicyState(np.concatenate([STATE.recurrent, pixels]))
    encoded = encode_state(state, version=VERSION, goal_digest=GOAL, pixels=256)
    assert len(encoded) == len(ENCODED) + 256
    decoded = decode_state(encoded, version=VERSION, goal_digest=GOAL, goals=3, size=259, pixels=256)
    assert decoded.recurrent.tobytes() == state.recurrent.tobytes()
    with pytest.raises(InvalidInput):
        decode_state(encoded[:-1], version=VERSION, goal_digest=GOAL, goals=3, size=259, pixels=256)


def test_a_policy_whose_state_would_be_longer_than_64_kib_cannot_be_made() -> None:
    empty = encode_state(PolicyState(np.zeros(0, np.float32)), version=VERSION, goal_digest=GOAL)
    floats = (MAX_STATE_BYTES - len(empty)) // 4
    with pytest.raises(InvalidInput):
        GoalConditionedSpec(**INPUTS, hidden_size=floats // 2 + 1)  # hidden state and cell


def test_the_state_of_another_model_or_goal_says_what_to_do() -> None:
    with pytest.raises(FailedPrecondition, match=VERSION) as other_model:
        decode(ENCODED, version=OTHER)
    assert "model" in other_model.value.hint
    with pytest.raises(FailedPrecondition, match="goal"):
        decode(ENCODED, goal=GOAL[::-1])


@pytest.mark.fault("I1")
@pytest.mark.parametrize(
    "state",
    [
        ENCODED[:-1],
        ENCODED + b"\0",
        ENCODED[:20],
        b"x" + ENCODED[1:],
        ENCODED[:-4] + np.float32("nan").tobytes(),
        ENCODED[:-4] + np.float32("inf").tobytes(),
        encode_state(PolicyState(STATE.recurrent, goal_index=4), version=VERSION, goal_digest=GOAL),
        bytes(MAX_STATE_BYTES),
    ],
)
def test_a_damaged_state_is_refused(state: bytes) -> None:
    with pytest.raises(InvalidInput) as error:
        decode(state)
    assert error.value.field == "state"


@given(at=st.integers(0, len(ENCODED) - 1), flip=st.integers(1, 255))
def test_a_changed_byte_is_refused_or_gives_a_state_within_bounds(at: int, flip: int) -> None:
    changed = ENCODED[:at] + bytes([ENCODED[at] ^ flip]) + ENCODED[at + 1 :]
    try:
        decoded = decode(changed)
    except (InvalidInput, FailedPrecondition):
        return
    assert 0 <= decoded.goal_index <= 3
    assert np.isfinite(decoded.recurrent).all()


@given(state=st.binary(max_size=200))
def test_any_bytes_are_refused(state: bytes) -> None:
    with pytest.raises(InvalidInput):
        decode(state)
