import numpy as np
import pytest
import torch

from freerein.learning import weights
from freerein.learning.encoders import ENCODERS, CameraEncoders
from freerein.learning.encoders.exposure import ExposureNormalisation
from freerein.types.common import Camera


def frames(count: int) -> torch.Tensor:
    """Returns frames of one background, uint8 (N, 16, 24, 3), with noise of a few levels."""
    rng = np.random.default_rng(0)
    background = rng.integers(60, 200, size=(16, 24, 3))
    return torch.from_numpy((background + rng.integers(-3, 4, size=(count, 16, 24, 3))).astype(np.uint8))


@pytest.fixture
def exposure() -> ExposureNormalisation:
    made = ExposureNormalisation(height=16, width=24, channels=3)
    made.fit(frames(40))
    return made


@pytest.mark.parametrize("light", [0.6, 1.2])
def test_frames_become_as_bright_as_the_training_frames(exposure: ExposureNormalisation, light: float) -> None:
    seen = frames(5)
    lit = (light * seen).round().clamp(max=255).to(torch.uint8)
    assert (exposure(lit).float() - seen.float()).abs().mean() < 3
    assert exposure(lit).dtype == torch.uint8


def test_a_tint_stays(exposure: ExposureNormalisation) -> None:
    tinted = exposure((frames(5) * torch.tensor([1.2, 1.0, 0.8])).round().clamp(max=255).to(torch.uint8)).float()
    red, _, blue = (tinted / frames(5)).mean(dim=(0, 1, 2))
    assert red > 1.15 * blue


def test_an_object_that_covers_a_third_of_the_frame_does_not_change_the_brightness_of_the_rest(
    exposure: ExposureNormalisation,
) -> None:
    seen = frames(5)
    covered = seen.clone()
    covered[:, :, :8] = 250
    assert (exposure(covered)[:, :, 8:].float() - seen[:, :, 8:].float()).abs().mean() < 3


def test_a_black_frame_stays_black(exposure: ExposureNormalisation) -> None:
    assert not exposure(torch.zeros_like(frames(1))).any()


def test_encoders_see_normalised_frames_of_each_camera() -> None:
    cameras = [Camera(name, 16, 24, 3) for name in ("front", "observation.images.wrist")]
    encoders = CameraEncoders(ENCODERS["spatial"], cameras, features=8, normalise_exposure=True)
    seen = {camera.name: frames(40) for camera in cameras}
    weights.initialise(encoders, generator=torch.Generator().manual_seed(0))
    encoders.fit_normalisation(seen, generator=torch.Generator().manual_seed(0))
    dim = {name: (0.7 * each).round().to(torch.uint8) for name, each in seen.items()}
    unnormalised = CameraEncoders(ENCODERS["spatial"], cameras, features=8)
    unnormalised.encoders.load_state_dict(encoders.encoders.state_dict())
    with torch.no_grad():
        nominal = encoders(seen)
        change, without = (encoders(dim) - nominal).abs().mean(), (unnormalised(dim) - nominal).abs().mean()
    assert change < without / 3
