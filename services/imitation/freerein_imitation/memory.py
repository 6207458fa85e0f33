"""What a policy has in mind between two observations, and how it travels: out as `state`, and back with the next call.

Whoever holds a `state` may have changed it, so that it is read as any other input is. It is bound to the model and the
goal that it came from:

    magic 4 | version 6 | digest of the goal 16 | goal index u32 | steps u32 | abandoned u8 | hidden M x f32
"""

import struct
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from freerein.errors import FailedPrecondition, InvalidInput

DIGEST_BYTES = 16
_MAGIC = b"fri1"
_HEADER = struct.Struct(f"<4s6s{DIGEST_BYTES}sIIB")


@dataclass(frozen=True, eq=False)
class Memory:
    """What a policy has in mind.

    Attributes:
        hidden: float32 (M,), the network's memory; zeros where a goal begins.
        goal_index: Goals done with, reached or given up.
        steps: Control steps taken towards the goal that is pursued.
        abandoned: Whether a goal was given up.
    """

    hidden: npt.NDArray[np.float32]
    goal_index: int = 0
    steps: int = 0
    abandoned: bool = False


def save(memory: Memory, *, version: str, goal: bytes) -> bytes:
    """Returns a memory as a `state`.

    Args:
        memory: The memory.
        version: The model's, 12 hexadecimal digits.
        goal: Digest of the whole goal.
    """
    header = _HEADER.pack(_MAGIC, bytes.fromhex(version), goal, memory.goal_index, memory.steps, memory.abandoned)
    return header + memory.hidden.astype("<f4", copy=False).tobytes()


def load(state: bytes, *, version: str, goal: bytes, goals: int, size: int) -> Memory:
    """Returns the memory that a `state` holds.

    Args:
        state: As `save` returned it, unless somebody changed it.
        version: The model's that is to go on.
        goal: Digest of the whole goal that is to be achieved.
        goals: How many goals it consists of.
        size: Numbers that the model's memory has.

    Raises:
        InvalidInput: It is none of ours, or damaged.
        FailedPrecondition: Another version of the model made it, or for another goal.
    """
    if len(state) < _HEADER.size or state[: len(_MAGIC)] != _MAGIC:
        raise _damaged()
    _, made_by, made_for, goal_index, steps, abandoned = _HEADER.unpack_from(state)
    if made_by != bytes.fromhex(version):
        raise FailedPrecondition(
            f"`state` must come from the model that is to go on, version {version}; it comes from {made_by.hex()}.",
            field="state",
            hint="Name in `model` the name and version that answered with this state, or begin anew without it.",
        )
    if made_for != goal:
        raise FailedPrecondition(
            "`state` must come from a call with the same goal; it comes from one with another.",
            field="state",
            hint="Send the whole goal unchanged in every call, or begin the new goal without a state.",
        )
    if len(state) != _HEADER.size + 4 * size or goal_index > goals or abandoned > 1:
        raise _damaged()
    hidden = np.frombuffer(state, "<f4", offset=_HEADER.size)
    if not np.isfinite(hidden).all():
        raise _damaged()
    return Memory(hidden, goal_index, steps, bool(abandoned))


def _damaged() -> InvalidInput:
    return InvalidInput(
        "`state` must be what the reply before returned; it is not, or it is damaged.",
        field="state",
        hint="Send the bytes back as they came, or nothing to begin anew.",
    )
