"""The sim service compiles the scenes of its own tasks only: no request holds a MuJoCo model, or a file's name."""

from collections.abc import Iterator

import pytest
from google.protobuf.descriptor import Descriptor, FieldDescriptor

from freerein.api.sim.v1 import sim_pb2

pytestmark = [pytest.mark.fault("M1"), pytest.mark.fault("M2"), pytest.mark.fault("M3")]

NAMES = {"task", "session", "idempotency_key", "cameras", "skills", "predicate", "datatype", "conditions"}
"""Texts of requests. All but keys are known names: of tasks, sessions, cameras, skills, predicates, conditions."""

BYTES = {"raw", "snapshot"}
"""Numbers of a tensor; a snapshot, which holds a state and no model."""


def fields_of(message: Descriptor, seen: set[str]) -> Iterator[FieldDescriptor]:
    """Yields the fields of a message and of all messages in it."""
    if message.full_name not in seen:
        seen.add(message.full_name)
        for field in message.fields:
            yield field
            if field.message_type is not None:
                yield from fields_of(field.message_type, seen)


def test_every_text_of_a_request_is_a_known_name_and_all_bytes_are_numbers() -> None:
    seen: set[str] = set()
    methods = sim_pb2.DESCRIPTOR.services_by_name["SimService"].methods
    fields = [field for method in methods for field in fields_of(method.input_type, seen)]

    assert {field.name for field in fields if field.type == FieldDescriptor.TYPE_STRING} == NAMES
    assert {field.name for field in fields if field.type == FieldDescriptor.TYPE_BYTES} == BYTES
