"""Plain lists of numbers in place of tensors."""

from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from freerein import tensors, wire
from freerein.api.sim.v1 import sim_pb2
from freerein.serving.rest.schemas import schema_of
from freerein.serving.rest.tensor_lists import MAX_LISTED, reply_json, tensor_of
from freerein.types.sim import CheckResponse, StepRequest

ACTIONS, FRAMES = ("FP32", "INT64"), ("UINT8",)


@pytest.mark.parametrize(
    ("nested", "datatypes", "expected"),
    [
        ([[0.5, -1]], ACTIONS, np.array([[0.5, -1]], np.float32)),
        ([[1], [2]], ACTIONS, np.array([[1], [2]], np.int64)),
        ([[1], [2]], ("FP64",), np.array([[1], [2]], np.float64)),
        ([], ACTIONS, np.empty(0, np.float32)),
        ([[], []], ACTIONS, np.empty((2, 0), np.float32)),
        ([[[[0, 255, 7]]]], FRAMES, np.array([[[[0, 255, 7]]]], np.uint8)),
        ([True, False], ("BOOL",), np.array([True, False])),
        ([-(2**63), 2**63 - 1], ACTIONS, np.array([-(2**63), 2**63 - 1])),
    ],
)
def test_a_list_is_the_tensor_that_its_field_expects(nested: Any, datatypes: Any, expected: np.ndarray) -> None:
    fields = tensor_of(nested, datatypes)
    array = tensors.decode(fields["datatype"], fields["shape"], fields["raw"])
    assert (array.dtype, array.shape, array.tolist()) == (expected.dtype, expected.shape, expected.tolist())


@pytest.mark.parametrize(
    ("nested", "datatypes", "reason"),
    [
        ([[1], [2, 3]], ACTIONS, "evenly"),
        ([[1], 2], ACTIONS, "evenly"),
        ([[[[[[[[[1]]]]]]]]], ACTIONS, "8 levels"),
        (["1"], ACTIONS, "only numbers"),
        ([None], ACTIONS, "only numbers"),
        ([{}], ACTIONS, "only numbers"),
        ([True], ACTIONS, "only numbers"),
        ([1], ("BOOL",), "true and false"),
        ([0.5], FRAMES, "whole numbers"),
        ([300, 44], FRAMES, "out of the range of UINT8"),
        ([-1], FRAMES, "out of the range of UINT8"),
        ([2**63], ACTIONS, "out of the range of INT64"),
        ([2**70], ACTIONS, "out of the range of INT64"),
        ([1e39, 0], ACTIONS, "out of the range of FP32"),
        ([10**400, 0.5], ACTIONS, "out of the range of FP32"),
    ],
)
def test_what_is_no_tensor_is_refused_and_says_why(nested: Any, datatypes: Any, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        tensor_of(nested, datatypes)


def test_a_request_takes_a_list_or_a_tensor() -> None:
    schema, array = schema_of(sim_pb2.StepRequest.DESCRIPTOR), np.array([[0.5, -0.5]], np.float32)
    for actions in (array.tolist(), wire.tensor_json(array)):
        body = {"session": "0" * 32, "step_id": 1, "actions": actions}
        request = wire.unpack(schema.model_validate(body, strict=True), StepRequest)
        assert np.array_equal(request.actions, array)
    with pytest.raises(ValidationError, match="evenly"):
        schema.model_validate({"session": "0" * 32, "step_id": 1, "actions": [[1], []]}, strict=True)


def test_a_reply_has_lists_but_of_large_tensors() -> None:
    small, large = np.array([[True, False]]), np.zeros((1, MAX_LISTED + 1), np.bool_)
    assert reply_json(CheckResponse(small)) == {"holds": [[True, False]]}
    assert reply_json(CheckResponse(large)) == wire.to_json(CheckResponse(large))
