"""Image files that a user names, as the services take them."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from freerein.errors import NotFound

if TYPE_CHECKING:
    from freerein.types.common import Image

FILES = "[CAMERA=]FILE"
"""How a user names one: with its camera where the model sees several."""

_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp")


def read_images(named: Sequence[str]) -> "tuple[Image, ...]":
    """Returns the images that a user names, those of a folder in the order of their names.

    Args:
        named: As `FILES` says; a folder stands for the images in it.

    Raises:
        NotFound: There is no such file, or no image in a folder.
        UnsupportedMedia: One is no PNG, JPEG or WebP.
    """
    return tuple(_read(path, camera) for text in named for camera, path in _files(text))


def _files(text: str) -> list[tuple[str, Path]]:
    camera, equals, rest = text.partition("=")
    if not equals or Path(text).exists():
        camera, rest = "", text
    path = Path(rest)
    if path.is_file():
        return [(camera, path)]
    found = sorted(file for file in path.glob("*") if file.suffix.lower() in _SUFFIXES)
    if not found:
        raise NotFound(
            "An image must be a file, or a folder with PNG, JPEG or WebP files; one of those named is neither.",
            field="image",
            hint="Name the camera before the file, as in front=now.png, only where the model sees several.",
        )
    return [(camera, file) for file in found]


def _read(path: Path, camera: str) -> "Image":
    from freerein import images
    from freerein.types.common import Image

    data = path.read_bytes()
    return Image(images.sniff(data, field="image"), 0, 0, data, camera)
