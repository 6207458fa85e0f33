import re
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

import pytest

from freerein.config import bounded, bounded_or_all, one_of, parse
from freerein.errors import InvalidInput


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


@dataclass(frozen=True)
class Nested:
    config: dict[str, Any]
    steps: tuple[dict[str, Any], ...] = ()
    policy: Literal["random"] | dict[str, Any] = "random"
    extra: dict[str, Any] = field(default_factory=dict)


def test_objects_and_one_of_several_kinds_can_be_given() -> None:
    values = {"config": {"a": 1}, "steps": [{"b": [2]}], "policy": {"run": "c"}}
    assert parse(Nested, values) == Nested({"a": 1}, ({"b": [2]},), {"run": "c"})
    assert parse(Nested, {"config": {}, "policy": "random"}) == Nested({})


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({}, "must hold config;"),
        ({"config": []}, "`config` must be an object"),
        ({"config": {}, "steps": [1]}, "`steps` must be a list of objects"),
        ({"config": {}, "policy": "none"}, "`policy` must be random or an object"),
    ],
)
def test_what_is_no_object_is_refused(values: dict[str, object], message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        parse(Nested, values)


def test_an_unknown_key_is_refused_and_the_nearest_known_one_named() -> None:
    with pytest.raises(InvalidInput) as error:
        parse(Config, {"names": [], "stepz": 3})
    assert "stepz" not in error.value.detail
    assert error.value.hint == "Did you mean `steps`?"


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({}, "must hold names"),
        ({"names": 1}, "`names` must be a list of strings"),
        ({"names": {"x": "y"}}, "`names` must be a list of strings"),
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


@dataclass(frozen=True)
class Longer(Config):
    steps: int = bounded(200, least=1, most=1000)


@dataclass(frozen=True)
class Looking:
    context: int | Literal["all"] = bounded_or_all("all", least=0, most=9)


def test_a_number_may_also_be_all() -> None:
    for context in (0, 9, "all"):
        assert parse(Looking, {"context": context}).context == context
    assert Looking().context == "all"
    with pytest.raises(InvalidInput, match=re.escape("`context` must be in [0, 9]; got 10")):
        Looking(10)
    with pytest.raises(InvalidInput, match=re.escape("`context` must be a whole number or all")):
        parse(Looking, {"context": "none"})


def test_what_is_out_of_bounds_cannot_be_made_in_any_way() -> None:
    with pytest.raises(InvalidInput, match=re.escape("`steps` must be in [1, 100]; got 101")):
        Config((), steps=101)
    with pytest.raises(InvalidInput, match=re.escape("`rate` must be in [0, 1]; got nan")):
        replace(Config(()), rate=float("nan"))


def test_a_subclass_may_have_another_default_and_other_bounds() -> None:
    assert (Config(()).steps, Longer(()).steps, Longer((), steps=101).steps) == (10, 200, 101)
    assert asdict(Longer(()))["rate"] == 0.5
    with pytest.raises(InvalidInput, match=re.escape("`steps` must be in [1, 1000]; got 1001")) as error:
        parse(Longer, {"names": [], "steps": 1001})
    assert error.value.field == "config.steps"


@dataclass(frozen=True)
class Place:
    name: str
    height: int = bounded(8, least=1, most=64)


@dataclass(frozen=True)
class Chosen:
    places: tuple[Place, ...] = ()
    best: Place = Place("here")
    scale: tuple[float, ...] = ()
    colour: str = one_of({"red": 1, "blue": 2}, "red")


def test_dataclasses_may_hold_others() -> None:
    values = {"places": [{"name": "a", "height": 2}], "best": {"name": "b"}, "scale": [1, 0.5], "colour": "blue"}
    assert parse(Chosen, values) == Chosen((Place("a", 2),), Place("b"), (1.0, 0.5), "blue")
    assert parse(Chosen, asdict(parse(Chosen, values))) == parse(Chosen, values)


def test_a_single_value_stands_for_a_list_of_one() -> None:
    assert parse(Config, {"names": "x"}).names == ("x",)
    assert parse(Chosen, {"places": {"name": "a"}, "scale": 2}) == Chosen((Place("a"),), scale=(2.0,))
    assert parse(Nested, {"config": {}, "steps": {"b": [2]}}).steps == ({"b": [2]},)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"places": [{"height": 2}]}, "must hold name"),
        ({"places": [{"name": "a", "height": 65}]}, "`height` must be in [1, 64]; got 65"),
        ({"places": ["a"]}, "`places` must be a list of objects"),
        ({"best": 1}, "`best` must be an object"),
        ({"scale": ["a"]}, "`scale` must be a list of finite numbers"),
        ({"colour": "green"}, "`colour` must be one of red, blue; got `green`"),
        ({"colour": 1}, "`colour` must be a string"),
    ],
)
def test_what_does_not_fit_a_dataclass_within_is_refused(values: dict[str, object], message: str) -> None:
    with pytest.raises(InvalidInput, match=re.escape(message)):
        parse(Chosen, values)
