"""Every list, map, text and configuration of a request has a bound in the contract, which both doors check.

`python tests/architecture/test_field_bounds.py` rewrites the table of bounds in `docs/protocol.md`.
"""

import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from google.protobuf import struct_pb2
from google.protobuf.descriptor import Descriptor, FieldDescriptor

from freerein import wire
from freerein.api.imitation.v1 import imitation_pb2
from freerein.api.learning.v1 import learning_pb2
from freerein.api.orchestrator.v1 import orchestrator_pb2
from freerein.api.reward.v1 import reward_pb2
from freerein.api.segmentation.v1 import segmentation_pb2
from freerein.api.sim.v1 import sim_pb2
from freerein.errors import InvalidInput
from freerein.field_bounds import bounds_of
from freerein.types.learning import StartFitRequest
from freerein.types.reward import RewardRequest
from freerein.types.sim import ResetRequest

CONTRACTS = (imitation_pb2, learning_pb2, orchestrator_pb2, reward_pb2, segmentation_pb2, sim_pb2)
STRUCT = struct_pb2.Struct.DESCRIPTOR
PAGE = Path(__file__).parents[2] / "docs" / "protocol.md"
TABLE = re.compile(r"(<!-- bounds: requests -->\n\n)(\|.*\n)*")


def request_fields() -> Iterator[FieldDescriptor]:
    """Yields the fields of all requests, and of the messages in them."""
    services = [service for contract in CONTRACTS for service in contract.DESCRIPTOR.services_by_name.values()]
    rest: list[Descriptor] = [method.input_type for service in services for method in service.methods]
    seen = set()
    while rest:
        message = rest.pop()
        if message.full_name not in seen:
            seen.add(message.full_name)
            yield from message.fields
            inner = [field.message_type for field in message.fields if field.message_type is not None]
            rest += [each for each in inner if each != STRUCT and not each.GetOptions().map_entry]


@pytest.mark.fault("F10")
def test_a_list_or_text_of_a_request_has_a_bound() -> None:
    for field in request_fields():
        bounds = bounds_of(field)
        is_map = field.message_type is not None and field.message_type.GetOptions().map_entry
        assert bounds.max_items or not field.is_repeated, field.full_name
        is_text = field.type == FieldDescriptor.TYPE_STRING or is_map or field.message_type == STRUCT
        assert bounds.max_length or not is_text, field.full_name


@pytest.mark.fault("F10")
@pytest.mark.parametrize(
    ("cls", "most", "words"),
    [
        (StartFitRequest, {"idempotency_key": "k" * 64}, "64 characters"),
        (RewardRequest, {"rivals": ["r" * 2000] * 64}, "64 elements"),
        (RewardRequest, {"rivals": ["r" * 2000]}, "`rivals.0` may have at most 2000 characters; got 2001"),
        (ResetRequest, {"envs": list(range(64))}, "64 elements"),
        (StartFitRequest, {"config": {"k": "v" * (32768 - 8)}}, "32768 bytes as JSON; got 32769"),
    ],
)
def test_a_field_may_be_as_long_as_its_bound_and_no_longer(cls: Any, most: dict[str, Any], words: str) -> None:
    ((name, value),) = most.items()
    wire.unpack(wire.message_type(cls)(**most), cls)
    longer: Any = {"k": value["k"] + "v"} if isinstance(value, dict) else value + value[:1]
    if words.startswith("`rivals.0`"):
        longer = [value[0] + "r"]
    with pytest.raises(InvalidInput, match=words) as raised:
        wire.unpack(wire.message_type(cls)(**{name: longer}), cls)
    assert raised.value.field.startswith(name)


@pytest.mark.fault("F11")
def test_a_key_that_the_caller_chose_is_not_repeated() -> None:
    secret = "password"
    for frames in ({secret: {"datatype": "FP99"}}, {secret * 9: {"datatype": "UINT8", "shape": [1], "raw": b"1"}}):
        with pytest.raises(InvalidInput) as raised:
            wire.unpack(reward_pb2.RewardRequest(frames=frames), RewardRequest)
        assert secret not in f"{raised.value.detail} {raised.value.field} {raised.value.hint}"


@pytest.mark.fault("F10")
def test_the_page_shows_the_bounds() -> None:
    page = PAGE.read_text()
    assert page == rewritten(page), f"{PAGE.name} is stale: run python tests/architecture/test_field_bounds.py"


def rewritten(page: str) -> str:
    """Returns a page with its table of bounds made anew."""
    names: dict[tuple[int, int, bool], set[str]] = defaultdict(set)
    for field in request_fields():
        if any(bounds := bounds_of(field)):
            name = f"{field.containing_type.name.removesuffix('Request')}.{field.name}"
            names[(*bounds, field.message_type == STRUCT)].add(f"`{name}`")
    rows = [f"| {words(*bounds)} | {', '.join(sorted(names[bounds]))} |\n" for bounds in sorted(names)]
    return TABLE.sub(lambda match: f"{match[1]}| at most | fields |\n|---|---|\n{''.join(rows)}", page)


def words(items: int, length: int, is_struct: bool) -> str:
    unit = "bytes as JSON" if is_struct else "characters"
    parts = [f"{items} elements"] * bool(items) + [f"{length} {unit}"] * bool(length)
    return " of ".join(parts) + " each" * bool(items and length)


if __name__ == "__main__":
    PAGE.write_text(rewritten(PAGE.read_text()))
