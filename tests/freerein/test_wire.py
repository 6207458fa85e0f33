"""Dataclasses, messages and JSON say the same thing."""

import base64
import inspect
from dataclasses import fields, is_dataclass, make_dataclass, replace
from types import SimpleNamespace
from typing import Any, TypeVar

import numpy as np
import pytest
from typing_extensions import TypeAliasType

from freerein import wire
from freerein.errors import InvalidInput
from freerein.types import common, imitation, learning, orchestrator, reward, segmentation, sim

DATACLASSES = [
    cls
    for module in (common, imitation, learning, orchestrator, reward, segmentation, sim)
    for _, cls in inspect.getmembers(module, is_dataclass)
    if cls.__module__ == module.__name__
]

SCALAR = TypeVar("SCALAR", bound=np.generic)
ARRAY = TypeAliasType("ARRAY", np.ndarray[Any, np.dtype[SCALAR]], type_params=(SCALAR,))  # NDArray since numpy 2.5

STEP = sim.StepResponse(
    step_id=7,
    frames={"front": np.arange(2 * 4 * 5 * 3, dtype=np.uint8).reshape(2, 4, 5, 3)},
    reward=np.zeros(2, np.float32),
    terminated=np.array([True, False]),
    truncated=np.array([False, False]),
    diverged=np.array([False, False]),
    final_frames={},
    truth=sim.Truth(np.ones((2, 3)), np.array([0.5, 1.0], np.float32), np.array([False, True])),
)
FIT = learning.Fit(
    id="0" * 32,
    state="running",
    dataset="demos",
    model_name="default",
    config={"steps": 5, "lr": 0.5, "objective": "lse"},
    metrics={"train_loss": 0.25},
    model=common.ModelRef("default", "abc"),
)


@pytest.mark.parametrize("cls", DATACLASSES, ids=lambda cls: cls.__name__)
def test_a_dataclass_and_its_message_have_the_same_fields(cls: type) -> None:
    assert {f.name for f in fields(cls)} == set(wire.message_type(cls).DESCRIPTOR.fields_by_name)


def test_arrays_maps_and_nested_messages_come_back_as_they_went() -> None:
    back = wire.unpack(wire.pack(STEP), sim.StepResponse)
    np.testing.assert_array_equal(back.frames["front"], STEP.frames["front"])
    assert back.terminated.tolist() == [True, False]
    assert back.truth is not None
    assert back.truth.state.dtype == np.float64


def test_terminations_come_back_as_they_went_also_where_they_are_unknown() -> None:
    known = common.Trajectory({}, np.zeros((2, 1), np.int64), terminated=np.array([False, True]))
    back = wire.unpack(wire.pack(known), common.Trajectory)
    assert back.terminated is not None
    assert (back.terminated.dtype, back.terminated.tolist()) == (np.bool_, [False, True])
    assert wire.unpack(wire.pack(replace(known, terminated=None)), common.Trajectory).terminated is None


def test_structs_enums_and_number_maps_come_back_as_they_went() -> None:
    assert wire.unpack(wire.pack(FIT), learning.Fit) == FIT


@pytest.mark.parametrize("is_json", [False, True])
def test_numbers_of_a_struct_are_ints_where_they_are_whole_and_exact(is_json: bool) -> None:
    numbers = {"whole": 3.0, "part": 0.5, "exact": 2.0**53 - 1, "huge": 1e30, "negative": -(2.0**53), "flag": True}
    asked = replace(FIT, config={**numbers, "literal": 10**30, "nested": [4.0]})
    source = SimpleNamespace(**vars(asked)) if is_json else wire.pack(asked)
    config = wire.unpack(source, learning.Fit).config
    assert config == {**numbers, "literal": 1e30, "nested": [4]}
    kinds = {name: type(value) for name, value in config.items()}
    assert {name for name, kind in kinds.items() if kind is int} == {"whole", "exact"}
    assert (kinds["flag"], type(config["nested"][0])) == (bool, int)


@pytest.mark.parametrize("value", [10**400, float("inf"), float("nan")])
def test_a_number_of_a_struct_that_no_double_holds_is_refused(value: float) -> None:
    with pytest.raises(InvalidInput) as error:
        wire.unpack(SimpleNamespace(**vars(replace(FIT, config={"steps": [value]}))), learning.Fit)
    assert error.value.field == "config"


def test_json_holds_lower_case_enums_and_base64_tensors() -> None:
    assert wire.to_json(FIT)["state"] == "running"
    assert wire.to_json(STEP)["reward"] == {"datatype": "FP32", "shape": [2], "raw": "AAAAAAAAAAA="}


@pytest.mark.parametrize("size", [0, 1, wire._BASE64_BYTES, 2 * wire._BASE64_BYTES + 1])
def test_bytes_of_any_length_are_one_text_in_base64(size: int) -> None:
    raw = bytes(range(251)) * (size // 251 + 1)
    written = wire.to_json(sim.SnapshotResponse(raw[:size]))["snapshot"]
    assert base64.b64decode(written, validate=True) == raw[:size]


def test_an_unset_optional_stays_none_and_an_unset_default_stays_the_default() -> None:
    request = wire.unpack(wire.message_type(segmentation.SegmentRequest)(), segmentation.SegmentRequest)
    assert request.frames is None
    assert request.model == common.ModelRef()


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_number_that_is_not_finite_is_refused_and_its_field_named(value: float) -> None:
    message = wire.message_type(segmentation.SegmentRequest)(smoothing=value)
    with pytest.raises(InvalidInput) as error:
        wire.unpack(message, segmentation.SegmentRequest)
    assert error.value.field == "smoothing"


def test_an_unspecified_enum_is_refused() -> None:
    message = wire.message_type(common.Image)(data=b"x")
    with pytest.raises(InvalidInput) as error:
        wire.unpack(message, common.Image, path="images.0")
    assert error.value.field == "images.0.encoding"


@pytest.mark.parametrize(("path", "field"), [("", "goal"), ("hello", "hello.goal")])
def test_a_required_field_that_is_missing_is_refused_and_named(path: str, field: str) -> None:
    with pytest.raises(InvalidInput, match=f"`{field}` is required") as error:
        wire.unpack(wire.message_type(imitation.Hello)(), imitation.Hello, path=path)
    assert error.value.field == field


@pytest.mark.parametrize(
    ("cls", "hints", "values"),
    [
        (
            segmentation.SegmentResponse,
            {"labels": ARRAY[np.int64], "confidence": ARRAY[np.float32]},
            {"labels": np.array([3, 1]), "confidence": np.array([0.5, 1], np.float32)},
        ),
        (
            common.Trajectory,
            {"frames": dict[str, ARRAY[np.uint8]], "actions": ARRAY[Any]},
            {"frames": {"front": np.ones((2, 1, 1, 3), np.uint8)}, "actions": np.zeros((2, 2), np.float32)},
        ),
        (segmentation.SegmentRequest, {"actions": ARRAY[Any] | None}, {"actions": np.zeros((2, 1), np.int64)}),
    ],
)
def test_arrays_do_not_depend_on_the_runtime_form_of_ndarray(
    cls: type, hints: dict[str, Any], values: dict[str, Any]
) -> None:
    aliased: Any = make_dataclass(cls.__name__, hints.items())
    aliased.__module__ = cls.__module__
    back = vars(wire.unpack(wire.pack(aliased(**values)), aliased))
    np.testing.assert_equal(back, values)
    assert [getattr(each, "dtype", None) for each in back.values()] == [
        getattr(each, "dtype", None) for each in values.values()
    ]
