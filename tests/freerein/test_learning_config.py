import re
from dataclasses import dataclass
from typing import Literal

import pytest

from freerein.errors import InvalidInput
from freerein.learning.config import bounded, parse


@dataclass(frozen=True)
class Config:
    names: tuple[str, ...]
    kind: Literal["a", "b"] = "a"
    camera: str = ""
    useful: bool = True
    steps: int = bounded(10, least=1, most=100)
    rate: float = bounded(0.5, least=0.0, most=1.0)


def test_what_is_left_out_has_its_default() -> None:
    assert parse(Config, {"names": ["x"]}) == Config(("x",))


def test_everything_can_be_given() -> None:
    values = {"names": ["x", "y"], "kind": "b", "camera": "front", "useful": False, "steps": 3, "rate": 1}
    assert parse(Config, values) == Config(("x", "y"), "b", "front", False, 3, 1.0)


def test_a_whole_number_may_come_as_a_float_as_from_a_protobuf_struct() -> None:
    steps = parse(Config, {"names": [], "steps": 3.0}).steps
    assert steps == 3
    assert type(steps) is int


def test_an_unknown_key_is_refused_and_the_nearest_known_one_named() -> None:
    with pytest.raises(InvalidInput) as error:
        parse(Config, {"names": [], "stepz": 3})
    assert "stepz" not in error.value.detail
    assert error.value.hint == "Did you mean `steps`?"


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({}, "must hold names"),
        ({"names": "x"}, "`names` must be a list of strings"),
        ({"names": [1]}, "`names` must be a list of strings"),
        ({"names": [], "kind": "c"}, "`kind` must be one of a, b"),
        ({"names": [], "camera": 1}, "`camera` must be a string"),
        ({"names": [], "useful": 1}, "`useful` must be true or false"),
        ({"names": [], "steps": 3.5}, "`steps` must be a whole number"),
        ({"names": [], "steps": True}, "`steps` must be a whole number"),
        ({"names": [], "steps": 0}, "`steps` must be in [1, 100]; got 0"),
        ({"names": [], "rate": float("nan")}, "`rate` must be a finite number"),
        ({"names": [], "rate": 1e400}, "`rate` must be a finite number"),
        ({"names": [], "rate": 1.5}, "`rate` must be in [0, 1]; got 1.5"),
        ({"names": [], "steps": 10**400}, "`steps` must be"),
    ],
)
def test_a_wrong_value_is_refused_by_name(values: dict[str, object], message: str) -> None:
    with pytest.raises(InvalidInput, match=re.escape(message)):
        parse(Config, values)
