"""Single images to look for things in, and the heatmaps that come of them."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import PIL.Image

from freerein import images
from freerein.errors import InvalidInput
from freerein.types.common import Image
from freerein.types.reward import Grounding
from freerein_reward.core.models import Preprocess
from freerein_reward.model import Grounds

MAX_HEATMAP_PIXELS = 12_000_000  # in FP32 and base64 these are the 64 MiB that a message may have


def read_image(image: Image, preprocess: Preprocess, *, phrases: int) -> tuple[npt.NDArray[np.uint8], tuple[int, int]]:
    """Returns an image as a model sees it, uint8 (1, H, W, 3), and its own height and width.

    Raises:
        InvalidInput: It is corrupt or too large, or its heatmaps for so many phrases would be.
        UnsupportedMedia: It is not in the encoding it claims.
    """
    pixels = phrases * images.pixel_count(image, field="image")
    if pixels > MAX_HEATMAP_PIXELS:
        raise InvalidInput(
            f"All heatmaps may have {MAX_HEATMAP_PIXELS} pixels together; got {pixels}, for {phrases} phrases.",
            field="image",
            hint="Scale the image down, or send fewer phrases per call.",
        )
    decoded = images.decode(image, field="image")
    return np.stack([preprocess(decoded)]), (decoded.shape[0], decoded.shape[1])


def check_pixels(encoded: Sequence[Image]) -> None:
    """Does nothing for images that are not too large together.

    Raises:
        InvalidInput: They are, or the header of one is corrupt.
        UnsupportedMedia: One is not in the encoding it claims.
    """
    total = sum(images.pixel_count(image, field=f"images.{place}") for place, image in enumerate(encoded))
    if total > images.MAX_REQUEST_PIXELS:
        raise InvalidInput(
            f"`images` may have {images.MAX_REQUEST_PIXELS} pixels together; got {total}.",
            field="images",
            hint="Scale the images down: the model sees less.",
        )


def read_images(encoded: Sequence[Image], preprocess: Preprocess, *, first: int) -> npt.NDArray[np.uint8]:
    """Returns some images as a model sees them, uint8 (N, H, W, 3).

    Args:
        encoded: The images.
        preprocess: Makes them into what the model sees.
        first: The place in the request of the first one, for errors.

    Raises:
        InvalidInput: One is corrupt.
        UnsupportedMedia: One is not in the encoding it claims.
    """
    decoded = (images.decode(image, field=f"images.{place}") for place, image in enumerate(encoded, start=first))
    return np.stack([preprocess(image) for image in decoded])


def groundings_of(found: Grounds, phrases: Sequence[str], size: tuple[int, int]) -> tuple[Grounding, ...]:
    """Returns where phrases are in the first image, in that image's own pixels.

    Args:
        found: What the model found.
        phrases: P of them.
        size: The image's own height and width.
    """
    height, width = size
    return tuple(
        Grounding(
            phrase=phrase,
            heatmap=_resize(found.heatmaps[0, place], height=height, width=width),
            x=float(found.x[0, place]) * width,
            y=float(found.y[0, place]) * height,
            presence=float(found.presence[0, place]),
        )
        for place, phrase in enumerate(phrases)
    )


def _resize(heatmap: npt.NDArray[np.float32], *, height: int, width: int) -> npt.NDArray[np.float32]:
    scaled = PIL.Image.fromarray(heatmap).resize((width, height), PIL.Image.Resampling.BILINEAR)
    return np.clip(np.asarray(scaled, np.float32), 0.0, 1.0)
