"""Snapshots of a vector env as bytes that clients store.

    sha256 of the rest (32) | header length (4) | header, JSON | for each environment: counters, generator, world

Snapshots are untrusted input: the hash detects damage only, so every number is checked, and a world checks its part.
"""

import hashlib
import json
import struct
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from freerein.errors import FailedPrecondition, InvalidInput
from freerein_sim.worlds import generators

FORMAT = 1

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
    if hashlib.sha256(data[_SHA256_BYTES:]).digest() != data[:_SHA256_BYTES]:
        raise _not_a_snapshot("bytes that do not match their hash")
    try:
        (length,) = _LENGTH.unpack_from(data, _SHA256_BYTES)
        end = _SHA256_BYTES + _LENGTH.size + length
        about = json.loads(data[_SHA256_BYTES + _LENGTH.size : end])
        if about["format"] != FORMAT:
            raise FailedPrecondition(
                f"`snapshot` must be of format {FORMAT}; got another.",
                field="snapshot",
                hint="Restore it with the build of the service that made it.",
            )
        envs = tuple(_decode_envs(data[end:]))
        snapshot = Snapshot(about["task"], about["fingerprint"], about["step_id"], envs)
        complete = about["num_envs"] == len(envs) and 0 <= snapshot.step_id < 2**63
    except (struct.error, ValueError, KeyError, TypeError) as error:
        raise _not_a_snapshot("bytes that cannot be read") from error
    if not complete or not isinstance(snapshot.step_id, int):
        raise _not_a_snapshot("numbers that no snapshot has")
    return snapshot


def _encode_env(env: EnvState) -> bytes:
    return _ENV.pack(env.steps, len(env.world), generators.pack(env.rng)) + env.world


def _decode_envs(data: bytes) -> Iterator[EnvState]:
    at = 0
    while at < len(data):
        steps, length, rng = _ENV.unpack_from(data, at)
        at += _ENV.size + length
        if at > len(data):
            raise ValueError("a length out of bounds")
        yield EnvState(steps, generators.unpack(rng), data[at - length : at])


def _not_a_snapshot(got: str) -> InvalidInput:
    return InvalidInput(
        f"`snapshot` must be what Snapshot returned; got {got}.", field="snapshot", hint="Send it back unchanged."
    )
