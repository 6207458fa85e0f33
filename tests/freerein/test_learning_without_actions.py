"""Fits of datasets without actions: what learns from images does, what needs actions says so."""

from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest

from freerein.data import DatasetSpec, create
from freerein.errors import InvalidInput
from freerein.learning.fit_config import DatasetFitConfig
from freerein.learning.methods import Method, Methods
from freerein.types.common import ActionSpec, Trajectory


@dataclass(frozen=True)
class Plain(DatasetFitConfig):
    """A configuration.

    Attributes:
        steps: Optimiser steps.
    """

    steps: int = 1
    batch_size: int = 1
    lr: float = 1.0
    warmup_steps: int = 1


@dataclass(frozen=True)
class WithActions(Plain):
    """A configuration.

    Attributes:
        use_actions: Whether actions are an input.
    """

    use_actions: bool = True


def method(config: type[Any], *, needs_actions: bool = True) -> Method[Any, Any, Any, Any]:
    def unused(*_: Any) -> Any:
        raise AssertionError

    return Method(config, lambda _, config: config, unused, unused, unused, needs_actions=needs_actions)


METHODS = Methods[Any](
    "toy",
    MappingProxyType(
        {"images": method(Plain, needs_actions=False), "either": method(WithActions), "actions": method(Plain)}
    ),
)


@pytest.fixture
def data_dir(tmp_path: Path) -> Path:
    for name, size in (("seen", 0), ("acted", 1)):
        spec = DatasetSpec(10, {"top": (4, 4, 3)}, ActionSpec(size, 0, ()), "toy")
        with create(tmp_path / "datasets" / name, spec) as writer:
            writer.append(Trajectory({"top": np.zeros((2, 4, 4, 3), np.uint8)}, np.zeros((2, size), np.float32)))
    return tmp_path


@pytest.mark.parametrize(("dataset", "expected"), [("seen", False), ("acted", True)])
def test_a_fit_uses_actions_where_there_are_any(data_dir: Path, dataset: str, expected: bool) -> None:
    assert METHODS.resolve(data_dir, dataset, {"method": "either"}, threads=1)["use_actions"] is expected
    assert METHODS.resolve(data_dir, dataset, {"method": "images"}, threads=1)["cameras"] == ("top",)


@pytest.mark.parametrize("asked", [{"method": "actions"}, {"method": "either", "use_actions": True}])
def test_a_fit_that_needs_actions_says_so(data_dir: Path, asked: dict[str, Any]) -> None:
    METHODS.resolve(data_dir, "acted", asked, threads=1)
    with pytest.raises(InvalidInput, match="learns from executed actions") as refused:
        METHODS.resolve(data_dir, "seen", asked, threads=1)
    assert refused.value.field == "dataset"
