"""Forged snapshots with a right hash: refused by the decoder, or decoded to values of the declared types."""

import hashlib
import json
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from freerein.errors import FailedPrecondition, InvalidInput, Unimplemented
from freerein_sim.workers import snapshots
from freerein_sim.workers.vector_env import VectorEnv
from freerein_sim.worlds import generators, grid
from freerein_sim.worlds.grid import GridWorld
from freerein_sim.worlds.world import TaskDefinition

pytestmark = pytest.mark.fault("F1")

HEADER = {"format": 1, "task": "grid", "fingerprint": "f", "step_id": 3, "num_envs": 1}
ENV = struct.pack("<II37s", 3, 5, generators.pack(np.random.default_rng(0))) + b"world"
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=4,
)


def forge(header: bytes, envs: bytes = ENV) -> bytes:
    body = struct.pack("<I", len(header)) + header + envs
    return hashlib.sha256(body).digest() + body


def changed(**fields: object) -> bytes:
    return json.dumps(HEADER | fields).encode()


def test_a_right_header_is_decoded() -> None:
    decoded = snapshots.decode(forge(changed()))

    assert (decoded.task, decoded.fingerprint, decoded.step_id) == ("grid", "f", 3)
    assert [(env.steps, env.world) for env in decoded.envs] == [(3, b"world")]


@pytest.mark.parametrize(
    ("header", "envs"),
    [
        (changed(step_id=True), ENV),
        (changed(step_id=3.0), ENV),
        (changed(step_id=-1), ENV),
        (changed(step_id=2**63), ENV),
        (changed(format=True), ENV),
        (changed(task=None), ENV),
        (changed(fingerprint=["f"]), ENV),
        (changed(more=1), ENV),
        (json.dumps({key: HEADER[key] for key in HEADER if key != "task"}).encode(), ENV),
        (changed(num_envs=0), b""),
        (changed(num_envs=2), ENV),
        (changed(num_envs=1), 2 * ENV),
        (changed(num_envs=65), 65 * ENV),
        (changed(task="t" * 5000), ENV),
        (b"[" * 4000, ENV),
        (b"[" * 200_000, ENV),
        (b"\xff", ENV),
        (b"1", ENV),
        (b"", ENV),
        (changed(), ENV[:-1]),
        (changed(), ENV + b"\0"),
        (changed(), struct.pack("<I", 3) + b"\xff" * 4 + ENV[8:]),
    ],
)
def test_a_forged_part_is_refused(header: bytes, envs: bytes) -> None:
    with pytest.raises(InvalidInput) as refused:
        snapshots.decode(forge(header, envs))
    assert refused.value.field == "snapshot"


@settings(max_examples=40, database=None)
@given(fields=st.dictionaries(st.sampled_from([*HEADER, "more"]), JSON, max_size=3), envs=st.binary(max_size=60))
def test_whatever_the_header_says_it_is_refused_or_has_the_declared_types(fields: dict[str, Any], envs: bytes) -> None:
    try:
        decoded = snapshots.decode(forge(changed(**fields), ENV + envs))
    except (InvalidInput, FailedPrecondition):
        return
    assert [type(each) for each in (decoded.task, decoded.fingerprint, decoded.step_id)] == [str, str, int]
    assert len(decoded.envs) == 1
    assert envs == b""


@pytest.mark.parametrize("call", [VectorEnv.snapshot, lambda envs: envs.restore(forge(changed()))])
def test_a_world_that_cannot_save_its_state_says_so(call: Callable[[VectorEnv], object]) -> None:
    class Unsaved:
        def __init__(self) -> None:
            world = GridWorld(indicator=True)
            self.spec, self.reset, self.render = world.spec, world.reset, world.render

    envs = VectorEnv(TaskDefinition("unsaved", "grid", "", grid.SPEC, Unsaved), num_envs=1, seed=0)
    envs.reset()

    with pytest.raises(Unimplemented, match="save its state"):
        call(envs)
