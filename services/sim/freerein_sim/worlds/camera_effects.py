"""Camera effects: pure functions of a rendered frame. Every task whose cameras see RGB declares them as conditions."""

import hashlib
import io
from collections.abc import Callable, Collection
from functools import partial

import numpy as np
import numpy.typing as npt
from PIL import Image

from freerein_sim.worlds.conditions import Condition

Frame = npt.NDArray[np.uint8]
"""uint8 (H, W, 3), RGB."""

Effect = Callable[[Frame], Frame]

_HUE_TURN = 0.1
"""Share of the colour circle."""

_JPEG_QUALITY = 30
_BLUR_AT_PX = 64
"""Frame height at which the blur's sigma is one pixel."""


def turn_hue(frame: Frame, *, by: float) -> Frame:
    """Returns the frame with each pixel's hue turned by a share of the colour circle; HSV value and saturation stay."""
    rgb = frame.astype(np.float32)
    value, least = rgb.max(axis=-1), rgb.min(axis=-1)
    chroma = value - least  # (H, W)
    red, green, blue = np.moveaxis(rgb, -1, 0)
    divisor = np.where(chroma > 0, chroma, 1)
    sector = np.select(
        [value == red, value == green],
        [(green - blue) / divisor, 2 + (blue - red) / divisor],
        4 + (red - green) / divisor,
    )
    phase = (np.array([5, 3, 1], np.float32) + (sector + 6 * by)[..., None]) % 6  # (H, W, 3)
    return _rounded(value[..., None] - chroma[..., None] * np.clip(np.minimum(phase, 4 - phase), 0, 1))


def scale_channels(frame: Frame, *, red: float, blue: float) -> Frame:
    """Returns the frame with two channels multiplied."""
    return _rounded(frame.astype(np.float32) * np.array((red, 1, blue), np.float32))


def blur(frame: Frame) -> Frame:
    """Returns the frame after a Gaussian blur, with a sigma of one pixel at 64 rows."""
    sigma = frame.shape[0] / _BLUR_AT_PX
    reach = max(1, round(3 * sigma))
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2).astype(np.float32)
    weights /= weights.sum()
    blurred = frame.astype(np.float32)
    for axis in (0, 1):
        padded = np.pad(blurred, [(reach, reach) if each == axis else (0, 0) for each in range(3)], mode="edge")
        parts = np.lib.stride_tricks.sliding_window_view(padded, len(weights), axis=axis)
        blurred = parts @ weights
    return _rounded(blurred)


def add_noise(frame: Frame, *, sigma: float) -> Frame:
    """Returns the frame with Gaussian noise in grey levels, drawn from its own hash: equal frames stay equal."""
    digest = hashlib.sha256(frame.tobytes()).digest()
    noise = np.random.default_rng(int.from_bytes(digest)).standard_normal(frame.shape, np.float32)
    return _rounded(frame.astype(np.float32) + sigma * noise)


def compress(frame: Frame) -> Frame:
    """Returns the frame after compression as a JPEG of quality 30."""
    with io.BytesIO() as file:
        Image.fromarray(frame).save(file, "JPEG", quality=_JPEG_QUALITY)
        with Image.open(file) as image:
            return np.array(image, np.uint8)


_DRAWN = "drawn from the frame's hash"
_EFFECTS: dict[Condition, Effect] = {
    Condition("hue-minus-10", "hue", "hue turned back by 36 degrees"): partial(turn_hue, by=-_HUE_TURN),
    Condition("hue-plus-10", "hue", "hue turned on by 36 degrees"): partial(turn_hue, by=_HUE_TURN),
    Condition("warm", "white-balance", "red times 1.15, blue times 0.85"): partial(scale_channels, red=1.15, blue=0.85),
    Condition("cool", "white-balance", "red times 0.85, blue times 1.15"): partial(scale_channels, red=0.85, blue=1.15),
    Condition("blur", "blur", "Gaussian blur, sigma one pixel at 64 rows"): blur,
    Condition("noise-10", "noise", f"Gaussian noise, sigma 10 grey levels, {_DRAWN}"): partial(add_noise, sigma=10),
    Condition("noise-20", "noise", f"Gaussian noise, sigma 20 grey levels, {_DRAWN}"): partial(add_noise, sigma=20),
    Condition("jpeg", "jpeg", "JPEG of quality 30"): compress,
}
"""In the order in which they apply: as light passes through lens, sensor and encoder."""

CONDITIONS = tuple(_EFFECTS)
EFFECTS = {condition.name: effect for condition, effect in _EFFECTS.items()}
"""By condition, in their order."""


def effects_of(conditions: Collection[str]) -> tuple[Effect, ...]:
    """Returns the effects among conditions, in the order in which they apply."""
    return tuple(effect for name, effect in EFFECTS.items() if name in conditions)


def _rounded(values: npt.NDArray[np.float32]) -> Frame:
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)
