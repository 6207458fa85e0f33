"""What requests of the sim service can say: no MuJoCo model, no file's name, no parameter of a physics."""

from collections import defaultdict
from collections.abc import Iterator

import pytest
from google.protobuf.descriptor import Descriptor, FieldDescriptor

from freerein.api.sim.v1 import sim_pb2

pytestmark = [pytest.mark.fault("M1"), pytest.mark.fault("M2"), pytest.mark.fault("M3")]

TEXTS = {"task", "session", "idempotency_key", "cameras", "skills", "predicate", "datatype", "conditions"}
"""All but keys are names that must be known: of tasks, sessions, cameras, skills, predicates, conditions."""

BYTES = {"raw", "snapshot"}
"""Numbers of a tensor; a snapshot, which holds a state and no model."""

NUMBERS = {
    *("num_envs", "envs", "sources", "height", "width"),  # the size of a scene is its task's
    *("seed", "step_id", "action_repeat", "lease_s", "privileged"),
    *("behaviour", "min_skills", "max_skills", "settle", "count", "first", "max_episode_steps"),
    "shape",
}
"""Numbers, flags and choices."""


def fields_of(message: Descriptor, seen: set[str]) -> Iterator[FieldDescriptor]:
    """Yields the fields of a message and of all messages in it."""
    if message.full_name not in seen:
        seen.add(message.full_name)
        for field in message.fields:
            yield field
            if field.message_type is not None:
                yield from fields_of(field.message_type, seen)


def test_no_field_of_a_request_describes_a_world() -> None:
    seen: set[str] = set()
    methods = sim_pb2.DESCRIPTOR.services_by_name["SimService"].methods
    found: dict[int, set[str]] = defaultdict(set)
    for method in methods:
        for field in fields_of(method.input_type, seen):
            found[field.type].add(field.name)
    found.pop(FieldDescriptor.TYPE_MESSAGE)

    assert found.pop(FieldDescriptor.TYPE_STRING) == TEXTS
    assert found.pop(FieldDescriptor.TYPE_BYTES) == BYTES
    assert set().union(*found.values()) == NUMBERS
