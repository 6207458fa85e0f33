"""The in-distribution score of the frames that a policy visits."""

import pytest
import torch
from torch import Tensor

from freerein.learning.image_statistics import image_statistics
from freerein_orchestrator.rl.visited_frames import fit_in_distribution

NUM_STEPS = 32
DOUBTFUL = 0.03  # scores below it are not to be trusted


def visited(num_envs: int, generator: torch.Generator) -> Tensor:
    """Returns noisy frames of an episode per environment, each of a scene of its own: uint8 (T * N, H, W, C)."""
    scenes = torch.randint(100, 156, (num_envs, 16, 16, 3), generator=generator)
    noise = torch.randint(-2, 3, (NUM_STEPS, *scenes.shape), generator=generator)
    return (scenes + noise).to(torch.uint8).flatten(end_dim=1)


def doubted_share(*, num_envs: int) -> float:
    """Returns the share of another episode's frames that a score of so many episodes takes for unfamiliar."""
    generator = torch.Generator().manual_seed(0)
    score = fit_in_distribution(visited(num_envs, generator), num_envs=num_envs)
    distances = score.distance(image_statistics({"front": visited(1, generator)}))
    return float((score(distances, torch.ones(NUM_STEPS)) < DOUBTFUL).float().mean())


@pytest.mark.parametrize("num_envs", [2, 7, 16])
def test_episodes_that_are_held_out_are_as_far_as_those_that_a_policy_will_be_in(num_envs: int) -> None:
    assert doubted_share(num_envs=num_envs) < 0.5


def test_a_single_environment_holds_out_the_later_half_of_its_frames() -> None:
    assert doubted_share(num_envs=1) == 1
