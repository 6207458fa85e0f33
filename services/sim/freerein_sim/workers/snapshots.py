"""Snapshots of a vector env as bytes that clients store.

    sha256 of the rest (32) | header length (4) | header, JSON | for each environment: counters, generator, world

Snapshots are untrusted input: the hash detects damage only, so every type and number is checked, and a world checks its
part. The service decodes a snapshot before a worker sees it.
"""

import hashlib
import json
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from freerein.errors import FailedPrecondition, InvalidInput
from freerein_sim.workers.protocol import MAX_ENVS
from freerein_sim.worlds import generators

FORMAT = 1

_HEADER_TYPES = {"format": int, "task": str, "fingerprint": str, "step_id": int, "num_envs": int}
_MAX_HEADER_BYTES = 4096
_SHA256_BYTES = 32
_LENGTH = struct.Struct("<I")
_ENV = struct.Struct(f"<II{generators.PACKED_BYTES}s")  # steps, length of the world's part, generator


@dataclass(frozen=True, eq=False)
class EnvState:
    """State of one environment: steps made in the episode, generator, and snapshot of the world."""

    steps: int
    rng: np.random.Generator
    world: bytes


@dataclass(frozen=True, eq=False)
class Snapshot:
    """State of a vector env, with the fingerprint of its worlds and the total number of steps."""

    task: str
    fingerprint: str
    step_id: int
    envs: tuple[EnvState, ...]


def encode(snapshot: Snapshot) -> bytes:
    """Encodes a snapshot."""
    about = {
        "format": FORMAT,
        "task": snapshot.task,
        "fingerprint": snapshot.fingerprint,
        "step_id": snapshot.step_id,
        "num_envs": len(snapshot.envs),
    }
    header = json.dumps(about).encode()
    body = b"".join((_LENGTH.pack(len(header)), header, *map(_encode_env, snapshot.envs)))
    return hashlib.sha256(body).digest() + body


def decode(data: bytes) -> Snapshot:
    """Decodes a snapshot. Raises InvalidInput or FailedPrecondition where it is damaged or of another format."""
    if hashlib.sha256(memoryview(data)[_SHA256_BYTES:]).digest() != data[:_SHA256_BYTES]:
        raise _not_a_snapshot("bytes that do not match their hash")
    try:
        (length,) = _LENGTH.unpack_from(data, _SHA256_BYTES)
        end = _SHA256_BYTES + _LENGTH.size + length
        about = _parse_header(data[_SHA256_BYTES + _LENGTH.size : end])
        envs = tuple(_decode_envs(data[end:], about["num_envs"]))
    except (struct.error, ValueError, RecursionError) as error:
        raise _not_a_snapshot("bytes that cannot be read") from error
    return Snapshot(about["task"], about["fingerprint"], about["step_id"], envs)


def _parse_header(header: bytes) -> dict[str, Any]:
    """Returns the header, after checking types and ranges. Raises ValueError or RecursionError where it is none."""
    about = json.loads(header) if len(header) <= _MAX_HEADER_BYTES else None
    if not isinstance(about, dict):
        raise ValueError("no header")
    if about.get("format") != FORMAT:
        raise FailedPrecondition(
            f"`snapshot` must be of format {FORMAT}; got another.",
            field="snapshot",
            hint="Restore it with the build of the service that made it.",
        )
    if {key: type(value) for key, value in about.items()} != _HEADER_TYPES:  # exactly: a bool is no int
        raise ValueError("other fields or types")
    if not (0 <= about["step_id"] < 2**63 and 1 <= about["num_envs"] <= MAX_ENVS):
        raise ValueError("a number out of bounds")
    return about


def _encode_env(env: EnvState) -> bytes:
    return _ENV.pack(env.steps, len(env.world), generators.pack(env.rng)) + env.world


def _decode_envs(data: bytes, num_envs: int) -> Iterator[EnvState]:
    at = 0
    for _ in range(num_envs):
        steps, length, rng = _ENV.unpack_from(data, at)
        at += _ENV.size + length
        yield EnvState(steps, generators.unpack(rng), data[at - length : at])
    if at != len(data):
        raise ValueError("a length out of bounds")


def _not_a_snapshot(got: str) -> InvalidInput:
    return InvalidInput(
        f"`snapshot` must be what `Snapshot` returned; got {got}.", field="snapshot", hint="Send it back unchanged."
    )
