"""JSON as REST takes it: the fields of the message, and nothing else."""

import inspect
from dataclasses import is_dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from pydantic import ValidationError

from freerein import wire
from freerein.serving.rest.schemas import schema_of
from freerein.types import common, imitation, learning, reward, segmentation, sim
from freerein.types.reward import RewardRequest
from freerein.types.segmentation import SegmentRequest

DATACLASSES = [
    cls
    for module in (common, imitation, learning, reward, segmentation, sim)
    for _, cls in inspect.getmembers(module, is_dataclass)
    if cls.__module__ == module.__name__
]
TENSOR = {"datatype": "UINT8", "shape": [1], "raw": "AA=="}


def accept(cls: type, value: object) -> Any:
    return schema_of(wire.descriptor_of(cls)).model_validate(value, strict=True)


@pytest.mark.parametrize("cls", DATACLASSES, ids=lambda cls: cls.__name__)
def test_the_fields_of_rest_are_the_fields_of_the_proto(cls: type) -> None:
    schema = schema_of(wire.descriptor_of(cls))
    assert list(schema.model_fields) == list(wire.descriptor_of(cls).fields_by_name)


@pytest.mark.parametrize("cls", DATACLASSES, ids=lambda cls: cls.__name__)
def test_every_schema_is_closed_and_can_be_shown(cls: type) -> None:
    shown = schema_of(wire.descriptor_of(cls)).model_json_schema()
    definitions = [shown, *shown.get("$defs", {}).values()]
    assert all(schema["additionalProperties"] is False for schema in definitions if "properties" in schema)


@pytest.mark.parametrize(
    ("cls", "value", "field"),
    [
        (SegmentRequest, {"unknown": 1}, "unknown"),
        (SegmentRequest, {"model": {"name": "a", "path": "b"}}, "path"),
        (SegmentRequest, {"smoothing": "1"}, "smoothing"),
        (SegmentRequest, {"smoothing": float("nan")}, "smoothing"),
        (SegmentRequest, {"smoothing": float("inf")}, "smoothing"),
        (SegmentRequest, {"min_segment": -1}, "min_segment"),
        (SegmentRequest, {"min_segment": 2**32}, "min_segment"),
        (SegmentRequest, {"min_segment": 1.5}, "min_segment"),
        (SegmentRequest, {"min_segment": True}, "min_segment"),
        (SegmentRequest, {"images": [{"data": ""}]}, "encoding"),
        (SegmentRequest, {"images": [{"encoding": "unspecified"}]}, "encoding"),
        (SegmentRequest, {"images": [{"encoding": 3}]}, "encoding"),
        (SegmentRequest, {"images": [{"encoding": "png", "url": "http://localhost/"}]}, "url"),
        (SegmentRequest, {"frames": {**TENSOR, "datatype": "FP16"}}, "datatype"),
        (SegmentRequest, {"frames": {**TENSOR, "shape": [-1]}}, 0),
        (SegmentRequest, {"frames": {**TENSOR, "shape": [2**63]}}, 0),
        (SegmentRequest, {"frames": {"datatype": "UINT8", "shape": []}}, "raw"),
        (RewardRequest, {"mode": "unspecified"}, "mode"),
        (learning.StartFitRequest, {"config": []}, "config"),
        (learning.StartFitRequest, [], None),
        (learning.WatchFitRequest, {"from_sequence": 2**64}, "from_sequence"),
    ],
)
def test_what_no_message_can_say_is_refused_where_it_stands(cls: type, value: object, field: object) -> None:
    with pytest.raises(ValidationError) as error:
        accept(cls, value)
    assert (error.value.errors()[0]["loc"] or [None])[-1] == field


@pytest.mark.fault("S5")
@pytest.mark.parametrize(
    "raw",
    [
        "AA",
        "AA=",
        "AA===",
        "AAAA=",
        "AAAA==",
        "AAAA====",
        "A A==",
        "AA==\n",
        "AA==AA==",
        "AA-_",
        "A",
        "data:image/png;base64,AA==",
        "ÄÄ==",
        "AAAA\0",
    ],
)
def test_base64_is_strict(raw: str) -> None:
    with pytest.raises(ValidationError, match="base64"):
        accept(SegmentRequest, {"frames": {**TENSOR, "raw": raw}})


@given(st.binary(max_size=40))
def test_every_byte_comes_through_base64(data: bytes) -> None:
    image = common.Image("png", 0, 0, data)
    assert wire.unpack(accept(common.Image, wire.to_json(image)), common.Image).data == data


def test_an_optional_enum_may_be_left_out() -> None:
    assert wire.unpack(accept(RewardRequest, {"goal_text": "a red block"}), RewardRequest).mode == "binary"


def test_a_million_bad_items_are_one_complaint() -> None:
    with pytest.raises(ValidationError) as error:
        accept(SegmentRequest, {"images": [1] * 1_000_000})
    assert error.value.error_count() == 1


@given(
    name=st.text(max_size=5),
    frames=hnp.arrays(np.uint8, hnp.array_shapes(min_dims=4, max_dims=4, max_side=3)),
    min_segment=st.integers(0, 2**32 - 1),
    smoothing=st.floats(allow_nan=False, allow_infinity=False),
)
def test_json_and_protobuf_say_the_same(name: str, frames: Any, min_segment: int, smoothing: float) -> None:
    request = SegmentRequest(common.ModelRef(name), frames, (), None, min_segment, smoothing)
    over_rest = wire.unpack(accept(SegmentRequest, wire.to_json(request)), SegmentRequest)
    over_grpc = wire.unpack(wire.pack(request), SegmentRequest)
    for back in (over_rest, over_grpc):
        assert (back.model, back.images, back.actions) == (request.model, (), None)
        assert (back.min_segment, back.smoothing) == (min_segment, smoothing)
        np.testing.assert_array_equal(back.frames, frames)
