"""Early fusion: what depends on one image is computed once for it, and pairs are those of a convolution of both."""

import torch
from torch import Tensor
from torch.nn import functional

from freerein.types.common import Camera
from freerein_imitation.methods.shared.goal_images.pair_encoder import PairEncoder

CAMERAS = (Camera("front", 20, 28, 1), Camera("wrist", 9, 16, 3))


def frames(count: int, seed: int) -> dict[str, Tensor]:
    generator = torch.Generator().manual_seed(seed)
    sizes = {each.name: (count, each.height, each.width, each.channels) for each in CAMERAS}
    return {name: torch.randint(256, size, generator=generator, dtype=torch.uint8) for name, size in sizes.items()}


def test_features_of_a_pair_are_those_of_a_convolution_that_sees_the_maps_of_both_images() -> None:
    torch.manual_seed(0)
    encoder = PairEncoder(CAMERAS, features=6)
    observations, goals = frames(5, seed=1), frames(5, seed=2)
    encoder.fit_normalisation(observations)
    found = encoder(encoder.encode(observations), encoder.encode(goals))

    expected = []
    for camera, each in zip(CAMERAS, encoder.encoders, strict=True):
        maps = torch.cat([functional.elu(each.first(each.standardised(i[camera.name]))) for i in (observations, goals)])
        weight = torch.cat([each.as_observation.weight, each.as_goal.weight], dim=1)
        bias = each.as_observation.bias + each.as_goal.bias
        both = torch.cat(maps.chunk(2), dim=1)  # (N, 2 * channels, rows, columns)
        fused = functional.elu(each.fused(functional.elu(functional.conv2d(both, weight, bias, stride=2, padding=1))))
        expected.append(functional.relu(each.norm(each.head(fused.flatten(start_dim=1)))))
    torch.testing.assert_close(found, torch.cat(expected, dim=1))
    assert found.shape == (5, encoder.size)


def test_goals_are_compared_with_each_of_many_observations() -> None:
    torch.manual_seed(0)
    encoder = PairEncoder(CAMERAS, features=6)
    observations, goals = encoder.encode(frames(6, seed=1)), encoder.encode(frames(2, seed=2))
    found = encoder(observations.view(2, 3, -1), goals[:, None].expand(-1, 3, -1))
    torch.testing.assert_close(found[1, 2], encoder(observations[5:], goals[1:])[0])
    assert not found[0].equal(encoder(observations.view(2, 3, -1), goals[[1, 0], None].expand(-1, 3, -1))[0])
