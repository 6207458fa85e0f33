"""Results and what is kept in the work folder are found by their configuration, modulo defaults."""

from dataclasses import dataclass, field
from pathlib import Path

import pytest
from experiments.workbench.cache_paths import cache_path
from experiments.workbench.configs import is_same, to_json


@dataclass(frozen=True)
class Split:
    count: int


@dataclass(frozen=True)
class Data:
    train: Split
    seed: int = 0


@dataclass(frozen=True)
class WithKeys(Data):
    condition: str = "nominal"
    test: Split = Split(0)
    cameras: tuple[str, ...] = field(default_factory=lambda: ("front",))


@dataclass(frozen=True)
class WithAnotherDefault(Data):
    seed: int = 1


STORED = to_json({"data": Data(Split(4)), "specs": [Data(Split(2), seed=3)], "version": 1})


def config(data: object, *specs: object, version: int = 1) -> dict[str, object]:
    return {"data": data, "specs": specs, "version": version}


@pytest.mark.parametrize(
    ("data", "spec"),
    [
        (Data(Split(4)), Data(Split(2), seed=3)),
        (WithKeys(Split(4)), WithKeys(Split(2), seed=3)),
        (WithAnotherDefault(Split(4), seed=0), Data(Split(2), seed=3)),
    ],
    ids=["as it was", "with new keys at their defaults", "with the stored value of a new default"],
)
def test_keys_that_are_added_with_a_default_change_no_configuration(data: Data, spec: Data) -> None:
    assert is_same(STORED, config(data, spec))


@pytest.mark.parametrize(
    "changed",
    [
        config(Data(Split(5)), Data(Split(2), seed=3)),
        config(Data(Split(4)), Data(Split(2), seed=4)),
        config(Data(Split(4)), Data(Split(2), seed=3), version=2),
        config(Data(Split(4)), Data(Split(2), seed=3), Data(Split(2))),
        config(WithKeys(Split(4), condition="blur"), Data(Split(2), seed=3)),
        config(WithAnotherDefault(Split(4)), Data(Split(2), seed=3)),
        config(Split(4), Data(Split(2), seed=3)),
        config(Data(Split(4)), Data(Split(2), seed=3)) | {"new": 0},
    ],
    ids=[
        "a value",
        "a value in a list",
        "a plain value",
        "a longer list",
        "a new key at another value",
        "a default",
        "a key that is gone",
        "a new key without a default",
    ],
)
def test_any_other_change_makes_another_configuration(changed: dict[str, object]) -> None:
    assert not is_same(STORED, changed)


def test_what_is_kept_is_found_again_after_keys_with_defaults_were_added(tmp_path: Path) -> None:
    kept = cache_path(tmp_path, {"data": Data(Split(4))}, prefix="arm-")
    assert kept.name.startswith("arm-")
    assert cache_path(tmp_path, {"data": WithKeys(Split(4))}, prefix="arm-") == kept
    others = [
        cache_path(tmp_path, {"data": WithAnotherDefault(Split(4))}, prefix="arm-"),
        cache_path(tmp_path, {"data": Data(Split(5))}, prefix="arm-"),
        cache_path(tmp_path, {"data": Data(Split(4))}, prefix="other-"),
    ]
    assert len({kept, *others}) == 4
