from typing import Any

import pytest
import torch

from freerein.learning import weights
from freerein.learning.encoders import (
    ENCODERS,
    CameraEncoders,
    ConvolutionalEncoder,
    MomentsEncoder,
    PatchEncoder,
    PrincipalEncoder,
    SpatialEncoder,
)
from freerein.types.common import Camera

SIZES = [(33, 30, 3), (64, 64, 3), (96, 128, 1), (112, 112, 1), (120, 320, 1)]
KINDS = pytest.mark.parametrize(
    "kind", [PatchEncoder, SpatialEncoder, MomentsEncoder, PrincipalEncoder, ConvolutionalEncoder]
)
TRAINED = pytest.mark.parametrize("kind", [PatchEncoder, SpatialEncoder, MomentsEncoder, ConvolutionalEncoder])
STILL = pytest.mark.parametrize("kind", [PatchEncoder, SpatialEncoder, MomentsEncoder, PrincipalEncoder])


def make(kind: Any, height: int, width: int, channels: int) -> Any:
    encoder = kind(height=height, width=width, channels=channels, features=16)
    weights.initialise(encoder, generator=torch.Generator().manual_seed(0))
    encoder.fit_normalisation(frames(height, width, channels))
    return encoder


def frames(height: int, width: int, channels: int, *, count: int = 4) -> torch.Tensor:
    generator = torch.Generator().manual_seed(1)
    return torch.randint(0, 256, (count, height, width, channels), generator=generator, dtype=torch.uint8)


@KINDS
@pytest.mark.parametrize("size", SIZES)
def test_frames_of_any_size_become_features(kind: Any, size: tuple[int, int, int]) -> None:
    features = make(kind, *size)(frames(*size))
    assert features.shape == (4, 16)
    assert features.dtype == torch.float32
    assert features.isfinite().all()


@KINDS
@pytest.mark.parametrize("size", SIZES)
def test_every_pixel_counts_even_in_the_last_corner(kind: Any, size: tuple[int, int, int]) -> None:
    encoder, seen = make(kind, *size), frames(*size, count=64)
    changed = seen.clone()
    changed[:, -1, -1] = 255 - changed[:, -1, -1]
    assert not torch.equal(encoder(seen), encoder(changed))


@pytest.mark.parametrize(
    ("size", "side"),
    [((33, 30, 3), 3), ((64, 64, 3), 6), ((112, 112, 1), 11), ((128, 128, 3), 12), ((120, 320, 1), 18)],
)
def test_a_wide_frame_has_about_as_many_patches_as_a_square_one(size: tuple[int, int, int], side: int) -> None:
    encoder = make(PatchEncoder, *size)
    assert isinstance(encoder, PatchEncoder)
    assert encoder.stem.stride == (side, side)


@STILL
def test_the_background_and_the_contrast_of_a_scene_do_not_matter(kind: Any) -> None:
    plain, scene = frames(64, 64, 3, count=8) // 4, frames(64, 64, 3, count=1) // 2
    darker, brighter = make(kind, 64, 64, 3), make(kind, 64, 64, 3)
    darker.fit_normalisation(plain)
    brighter.fit_normalisation(plain * 2 + scene)
    torch.testing.assert_close(darker(plain), brighter(plain * 2 + scene), atol=1e-4, rtol=1e-4)


@KINDS
def test_a_frame_is_encoded_alike_alone_and_among_others(kind: Any) -> None:
    encoder, seen = make(kind, 64, 64, 3), frames(64, 64, 3)
    torch.testing.assert_close(encoder(seen[1:2]), encoder(seen)[1:2])


@TRAINED
def test_weights_depend_on_the_generator_alone(kind: Any) -> None:
    torch.manual_seed(5)
    first = make(kind, 33, 30, 3)
    torch.manual_seed(6)
    assert weights.sha256(make(kind, 33, 30, 3)) == weights.sha256(first)
    weights.initialise(first, generator=torch.Generator().manual_seed(1))
    assert weights.sha256(make(kind, 33, 30, 3)) != weights.sha256(first)


def test_moments_follow_what_moves_to_half_a_pixel() -> None:
    encoder = MomentsEncoder(height=64, width=64, channels=3, features=40)
    weights.initialise(encoder, generator=torch.Generator().manual_seed(0))
    encoder.fit_normalisation(torch.cat([torch.zeros(1, 64, 64, 3), torch.full((1, 64, 64, 3), 100.0)]).byte())
    torch.nn.init.zeros_(encoder.stem.bias)
    torch.nn.init.zeros_(encoder.heat.bias)  # no heat from the background
    encoder.heat.weight.data.mul_(100)  # so much heat that means are not shrunk
    seen = torch.full((40, 64, 64, 3), 50, dtype=torch.uint8)
    for shift, frame in enumerate(seen):
        frame[20:30, 5 + shift : 15 + shift] = 255
    mass, columns, rows = encoder(seen).view(40, 8, 5).detach().unbind(dim=2)[:3]
    hottest = int(mass.mean(dim=0).argmax())
    pixel = (columns[-1, hottest] - columns[0, hottest]) / 39
    expected = columns[0, hottest] + pixel * torch.arange(40)
    assert pixel > 0.1
    torch.testing.assert_close(columns[:, hottest], expected, atol=float(pixel) / 2, rtol=0)
    torch.testing.assert_close(rows[:, hottest], rows[:1, hottest].expand(40), atol=float(pixel) / 2, rtol=0)


def test_a_layer_that_cannot_be_drawn_is_a_bug_found_at_once() -> None:
    with pytest.raises(TypeError, match="Bilinear"):
        weights.initialise(torch.nn.Sequential(torch.nn.Bilinear(2, 2, 2)), generator=torch.Generator())


def test_frozen_parameters_are_not_drawn() -> None:
    network = torch.nn.Sequential(torch.nn.Bilinear(2, 2, 2), torch.nn.Linear(2, 2)).requires_grad_(False)
    before = weights.sha256(network)
    weights.initialise(network, generator=torch.Generator().manual_seed(0))
    assert weights.sha256(network) == before


@pytest.mark.parametrize("name", ENCODERS)
def test_every_encoder_has_as_few_features_as_it_says(name: str) -> None:
    kind = ENCODERS[name]
    encoders = CameraEncoders(kind, (Camera("front", 16, 16, 3),), features=kind.min_features)
    generator = torch.Generator().manual_seed(0)
    weights.initialise(encoders, generator=generator)
    seen = {"front": frames(16, 16, 3)}
    encoders.fit_normalisation(seen, generator=generator)
    assert encoders(seen).shape == (4, kind.min_features)


@pytest.mark.parametrize("name", ENCODERS)
def test_every_encoder_takes_several_cameras_of_different_sizes(name: str) -> None:
    cameras = (Camera("front", 33, 30, 3), Camera("wrist", 16, 24, 1))
    encoders = CameraEncoders(ENCODERS[name], cameras, features=12)
    generator = torch.Generator().manual_seed(0)
    weights.initialise(encoders, generator=generator)
    seen = {camera.name: frames(camera.height, camera.width, camera.channels) for camera in cameras}
    encoders.fit_normalisation(seen, generator=generator)
    features = encoders(seen)
    assert features.shape == (4, encoders.size) == (4, 24)
    assert features.isfinite().all()
    torch.testing.assert_close(encoders(seen | {"wrist": seen["wrist"].flip(0)})[:, :12], features[:, :12])


def test_principal_components_tell_where_a_light_is_and_those_beyond_the_rank_are_zeros() -> None:
    places = torch.linspace(5, 27, 40)
    brightness = 200 * torch.exp(-((torch.arange(32) - places[:, None]) ** 2) / 50)
    seen = brightness.round().to(torch.uint8)[:, None, :, None].expand(-1, 8, -1, -1)  # (40, 8, 32, 1)
    encoder = PrincipalEncoder(height=8, width=32, channels=1, features=64)
    encoder.fit_normalisation(seen[::2])
    features, few = encoder(seen), encoder(seen)[:, :8]
    fitted = torch.linalg.lstsq(few[::2], places[::2, None] - places[::2].mean()).solution
    torch.testing.assert_close((few @ fitted)[1::2, 0], places[1::2] - places[::2].mean(), atol=0.1, rtol=0)
    assert not features[:, 32:].any()
    assert features[:, 0].std() > features[:, 1].std() > features[:, 2].std() > 0


def test_an_encoder_that_tells_no_frames_apart_is_dead_and_one_that_was_shown_one_frame_is_not() -> None:
    camera = Camera("top", 33, 30, 3)
    encoders, seen = CameraEncoders(PatchEncoder, (camera,), features=8), frames(33, 30, 3)
    weights.initialise(encoders, generator=torch.Generator().manual_seed(0))
    encoders.fit_normalisation({"top": seen}, generator=torch.Generator())
    assert encoders.dead_cameras() == []
    stem = encoders.encoders[0].stem
    assert isinstance(stem, torch.nn.Conv2d)
    torch.nn.init.constant_(stem.bias, -1e6)  # below zero for every frame: relu lets nothing through
    assert encoders.dead_cameras() == ["top"]
    encoders.fit_normalisation({"top": seen[:1].repeat(4, 1, 1, 1)}, generator=torch.Generator())
    assert encoders.dead_cameras() == []
