"""Image files of the command line, read as the services expect them."""

from collections.abc import Sequence
from pathlib import Path

from freerein import images
from freerein.data.image_names import natural
from freerein.errors import NotFound
from freerein.types.common import Image

FILES = "[CAMERA=]FILE"
"""Syntax of an image option; the camera is needed where the model has several."""

_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp")


def read_images(named: Sequence[str]) -> tuple[Image, ...]:
    """Returns the images in files or folders, each named as `FILES` describes; a folder's in the order of their names.

    `2.png` comes before `10.png`.


    Raises NotFound where there is no image, UnsupportedMedia where a file is not PNG, JPEG or WebP.
    """
    return tuple(_read(path, camera) for text in named for camera, path in _files(text))


def _files(text: str) -> list[tuple[str, Path]]:
    camera, equals, rest = text.partition("=")
    if not equals or Path(text).exists():
        camera, rest = "", text
    path = Path(rest)
    if path.is_file():
        return [(camera, path)]
    found = sorted((file for file in path.glob("*") if file.suffix.lower() in _SUFFIXES), key=natural)
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
