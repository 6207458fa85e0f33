"""A policy's state between two observations, and its encoding as the API's opaque `state`.

Callers may change a `state`, so it is read as untrusted. It is bound to the model version and the goal:

    magic 4 | version 6 | goal digest 16 | goal index u32 | goal steps u32 | abandoned u8 | recurrent state

The last P of the R numbers of a recurrent state may be pixels, whole numbers of 0 to 255, which have a byte each:

    recurrent state = (R - P) x f32 | P x u8
"""

import struct
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from freerein.errors import FailedPrecondition, InvalidInput, must_be

DIGEST_BYTES = 16
_MAGIC = b"fri1"
_HEADER = struct.Struct(f"<4s6s{DIGEST_BYTES}sIIB")


@dataclass(frozen=True, eq=False)
class PolicyState:
    """Recurrent state and progress through a sequence of goals.

    Attributes:
        recurrent: Recurrent state, float32 (R,); zeros at the start, and of each goal unless the policy keeps it.
        goal_index: Number of goals that are over, reached or abandoned.
        goal_steps: Control steps taken towards the current goal.
        abandoned: Whether a goal was abandoned.
    """

    recurrent: npt.NDArray[np.float32]
    goal_index: int = 0
    goal_steps: int = 0
    abandoned: bool = False


def encode_state(state: PolicyState, *, version: str, goal_digest: bytes, pixels: int = 0) -> bytes:
    """Returns a policy state as bytes.

    Args:
        state: Policy state.
        version: Model version, 12 hexadecimal digits.
        goal_digest: Digest of the whole goal.
        pixels: P, how many of the last numbers of the recurrent state are pixels.
    """
    progress = (state.goal_index, state.goal_steps, state.abandoned)
    header = _HEADER.pack(_MAGIC, bytes.fromhex(version), goal_digest, *progress)
    numbers, remembered = np.split(state.recurrent, [len(state.recurrent) - pixels])
    return header + numbers.astype("<f4", copy=False).tobytes() + remembered.astype(np.uint8).tobytes()


def decode_state(
    data: bytes, *, version: str, goal_digest: bytes, goals: int, size: int, pixels: int = 0
) -> PolicyState:
    """Returns the policy state in bytes that `encode_state` should have returned.

    Args:
        data: The API's `state`.
        version: Version of the model that continues.
        goal_digest: Digest of the whole goal.
        goals: Number of goals.
        size: R, numbers of the model's recurrent state.
        pixels: P, how many of the last of them are pixels.

    Raises:
        InvalidInput: The bytes are malformed.
        FailedPrecondition: The state is of another model version or goal.
    """
    if len(data) < _HEADER.size or data[: len(_MAGIC)] != _MAGIC:
        raise _malformed()
    _, state_version, state_goal, goal_index, goal_steps, abandoned = _HEADER.unpack_from(data)
    if state_version != bytes.fromhex(version):
        raise FailedPrecondition(
            f"`state` must come from the model that continues, version {version}; got one of {state_version.hex()}.",
            field="state",
            hint="Name in `model` the name and version that returned this state, or start anew without it.",
        )
    if state_goal != goal_digest:
        raise FailedPrecondition(
            "`state` must come from a call with the same goal; got one of another goal.",
            field="state",
            hint="Send the whole goal unchanged in every call, or start the new goal without a state.",
        )
    numbers = size - pixels
    if len(data) != _HEADER.size + 4 * numbers + pixels or goal_index > goals or abandoned > 1:
        raise _malformed()
    recurrent = np.frombuffer(data, "<f4", numbers, offset=_HEADER.size)
    if not np.isfinite(recurrent).all():
        raise _malformed()
    if pixels:
        remembered = np.frombuffer(data, np.uint8, offset=_HEADER.size + 4 * numbers)
        recurrent = np.concatenate([recurrent, remembered.astype(np.float32)])
    return PolicyState(recurrent, goal_index, goal_steps, bool(abandoned))


def _malformed() -> InvalidInput:
    hint = "Send the bytes unchanged, or nothing to start anew."
    return must_be("state", "the `state` of the previous reply", "something else", hint=hint)
