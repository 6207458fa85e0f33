"""Image files of the command line, read as the services expect them."""

from collections.abc import Sequence
from pathlib import Path

from freerein import images
from freerein.data.recordings import image_series, images_of
from freerein.errors import NotFound
from freerein.types.common import Image

FILES = "[CAMERA=]FILE"
"""Syntax of an image option; the camera is needed where the model has several."""


def read_images(named: Sequence[str], *, is_series: bool = False) -> tuple[Image, ...]:
    """Returns the images in files or folders, each named as `FILES` describes; a folder's in the order of their names.

    `2.png` comes before `10.png`. Those of a series are in the order in which a dataset is imported: by number or time.


    Raises NotFound where there is no image, UnsupportedMedia where a file is not PNG, JPEG or WebP, InvalidInput where
    the names of a series have several orders.
    """
    return tuple(_read(path, camera) for text in named for camera, path in _files(text, is_series=is_series))


def _files(text: str, *, is_series: bool) -> list[tuple[str, Path]]:
    camera, equals, rest = text.partition("=")
    if not equals or Path(text).exists():
        camera, rest = "", text
    path = Path(rest)
    if path.is_file():
        return [(camera, path)]
    found = image_series(path) if is_series else images_of(path)
    if not found:
        raise NotFound(
            "An image must be a file, or a folder of PNG, JPEG or WebP files; got neither.",
            field="image",
            hint="Write now.png, or front=now.png where the model has several cameras.",
        )
    return [(camera, file) for file in found]


def _read(path: Path, camera: str) -> Image:
    data = path.read_bytes()
    return Image(images.sniff(data, field="image"), 0, 0, data, camera)
