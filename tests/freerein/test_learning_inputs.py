from dataclasses import dataclass

import pytest

from freerein.config import bounded
from freerein.errors import InvalidInput
from freerein.learning.fit_config import DatasetFitConfig
from freerein.learning.inputs import InputSpec, spec_of
from freerein.types.common import ActionSpec, Camera

CAMERAS = (Camera("front", 12, 12, 3),)
ACTION = ActionSpec(1, 0, ("right",))


@dataclass(frozen=True)
class Config(DatasetFitConfig):
    features: int = bounded(16, least=8, most=1024)


@dataclass(frozen=True, kw_only=True)
class Spec(InputSpec):
    skills: tuple[str, ...]
    features: int = bounded(32, least=8, most=64)
    stride: int = 1


def test_a_spec_has_the_sizes_of_its_configuration_and_else_what_is_given_or_its_defaults() -> None:
    config = Config(cameras=("front",), features=20)
    spec = spec_of(config, Spec, cameras=CAMERAS, action=ACTION, skills=("pick",))
    assert spec == Spec(cameras=CAMERAS, action=ACTION, skills=("pick",), features=20, stride=1)


def test_a_configuration_that_no_network_is_made_for_is_refused() -> None:
    with pytest.raises(InvalidInput, match="`features` must be in"):
        spec_of(Config(features=100), Spec, cameras=CAMERAS, action=ACTION, skills=("pick",))
