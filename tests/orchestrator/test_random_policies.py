"""Random exploration is the same in the orchestrator, which cannot import the sim service, and in the sim service."""

import pytest

from freerein_orchestrator.envs import random_policies
from freerein_sim.worlds import random_policy


@pytest.mark.parametrize("name", ["_MEAN_HOLD_STEPS", "_SMOOTHING", "_EXTREME_PROBABILITY"])
def test_the_parameters_of_random_exploration_are_those_of_the_sim_service(name: str) -> None:
    assert getattr(random_policies, name) == getattr(random_policy, name)
