"""Encoded images to pixels and back: PNG, JPEG, WebP, raw RGB and raw gray, and nothing else.

Untrusted bytes meet three gates before a decoder runs: the format is one of those allowed, the header's pixel count
is under the cap, and there is one frame. Error messages are ours, never the decoder's.
"""

import io
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import numpy.typing as npt
import PIL.Image
import PIL.ImageOps

from freerein.errors import InvalidInput, ServiceError, UnsupportedMedia
from freerein.types.common import Encoding, Image

MAX_PIXELS = 16_000_000
MAX_REQUEST_PIXELS = 64_000_000

_RAW_CHANNELS: dict[Encoding, int] = {"raw_rgb8": 3, "raw_gray8": 1}
_PILLOW_FORMATS: dict[Encoding, str] = {"png": "PNG", "jpeg": "JPEG", "webp": "WEBP"}
_PNG_BIT_DEPTH = 24  # where a PNG's header says it; Pillow cuts 16-bit colour down without a word
_SIGNATURES: tuple[tuple[int, bytes, Encoding], ...] = (
    (0, b"\x89PNG\r\n\x1a\n", "png"),
    (0, b"\xff\xd8\xff", "jpeg"),
    (8, b"WEBP", "webp"),
)


def sniff(data: bytes, *, field: str = "images") -> Encoding:
    """Returns the encoding that a file's first bytes announce.

    Raises:
        UnsupportedMedia: It is no PNG, JPEG or WebP.
    """
    for offset, signature, encoding in _SIGNATURES:
        if data[offset : offset + len(signature)] == signature:
            return encoding
    raise UnsupportedMedia(
        f"`{field}` must be PNG, JPEG or WebP files; got {len(data)} bytes that begin like none of them.",
        field=field,
        hint="Convert the image first, for example to PNG.",
    )


def decode(image: Image, *, field: str = "images") -> npt.NDArray[np.uint8]:
    """Returns an image's pixels.

    Colour files (palette, CMYK, alpha) become RGB, the alpha channel dropped; 8-bit gray stays gray; EXIF orientation
    is applied to JPEG once.

    Returns:
        uint8 (height, width, channels), channels 1 or 3; read-only for the raw encodings.

    Raises:
        UnsupportedMedia: The data is not in the encoding it claims.
        InvalidInput: Corrupt, truncated, animated, empty, more than 8 bits deep, of another size than claimed, or of
            more than `MAX_PIXELS` pixels.
    """
    if image.encoding in _RAW_CHANNELS:
        return _decode_raw(image, field)
    pixels = _decode_file(image, field)
    claimed = (image.height or pixels.shape[0], image.width or pixels.shape[1])
    if pixels.shape[:2] != claimed:
        raise InvalidInput(
            f"`{field}` must have the height and width it names, {claimed[0]} x {claimed[1]}; "
            f"the file has {pixels.shape[0]} x {pixels.shape[1]}.",
            field=field,
            hint="Leave height and width 0 for encoded files.",
        )
    return pixels


def pixel_count(image: Image, *, field: str = "images") -> int:
    """Returns how many pixels an image will decode to, read from its header alone.

    Raises:
        UnsupportedMedia: The data is not in the encoding it claims.
        InvalidInput: The header is corrupt, or more than `MAX_PIXELS` pixels.
    """
    if image.encoding in _RAW_CHANNELS:
        _check_pixels(image.height, image.width, field)
        return image.height * image.width
    with _open(image, field) as opened:
        return opened.width * opened.height


def encode(pixels: npt.NDArray[np.uint8], *, encoding: Encoding = "png", camera: str = "") -> Image:
    """Returns pixels as an encoded image.

    Args:
        pixels: uint8 (height, width, channels), channels 1 or 3.
        encoding: A raw encoding must fit the number of channels.
        camera: Which camera took it.

    Raises:
        InvalidInput: The array is no such image.
    """
    if pixels.dtype != np.uint8 or pixels.ndim != 3 or pixels.shape[2] not in (1, 3):
        raise InvalidInput(
            f"An image must be uint8 (height, width, 1 or 3); got {pixels.dtype} {pixels.shape}.",
            hint="Transpose channels-first arrays, and scale floats to 0..255.",
        )
    height, width, channels = pixels.shape
    if encoding in _RAW_CHANNELS:
        if channels != _RAW_CHANNELS[encoding]:
            raise InvalidInput(
                f"{encoding} holds {_RAW_CHANNELS[encoding]} channels; got {channels}.",
                hint="Use raw_gray8 for one channel, raw_rgb8 for three.",
            )
        return Image(encoding, height, width, pixels.tobytes(), camera)
    buffer = io.BytesIO()
    mode_pixels = pixels[:, :, 0] if channels == 1 else pixels
    PIL.Image.fromarray(mode_pixels).save(buffer, _PILLOW_FORMATS[encoding])
    return Image(encoding, height, width, buffer.getvalue(), camera)


def _decode_raw(image: Image, field: str) -> npt.NDArray[np.uint8]:
    channels = _RAW_CHANNELS[image.encoding]
    _check_pixels(image.height, image.width, field)
    expected = image.height * image.width * channels
    if len(image.data) != expected:
        raise InvalidInput(
            f"`{field}` must hold height x width x {channels} = {expected} bytes; got {len(image.data)}.",
            field=field,
            hint="Send the rows one after another, without padding.",
        )
    return np.frombuffer(image.data, np.uint8).reshape(image.height, image.width, channels)


def _decode_file(image: Image, field: str) -> npt.NDArray[np.uint8]:
    with _open(image, field) as opened:
        upright = PIL.ImageOps.exif_transpose(opened) if image.encoding == "jpeg" else opened
        if "transparency" in upright.info:  # Pillow warns of converting it in one step
            upright = upright.convert("LA" if upright.mode in ("1", "L") else "RGBA")
        pixels = np.asarray(upright.convert("L" if upright.mode in ("1", "L", "LA") else "RGB"))
    return pixels.reshape(pixels.shape[0], pixels.shape[1], -1)


@contextmanager
def _open(image: Image, field: str) -> Iterator[PIL.Image.Image]:
    """Opens a file lazily behind the gates; whatever a decoder raises becomes one sentence of ours."""
    if sniff(image.data, field=field) != image.encoding:
        raise UnsupportedMedia(
            f"`{field}` must be in the encoding it names, {image.encoding}; its bytes begin like another.",
            field=field,
            hint="Name the encoding that the file really has.",
        )
    try:
        with PIL.Image.open(io.BytesIO(image.data), formats=[_PILLOW_FORMATS[image.encoding]]) as opened:
            _check_pixels(opened.height, opened.width, field)
            _check_kind(opened, image, field)
            yield opened
    except ServiceError:
        raise
    except (PIL.Image.DecompressionBombError, PIL.Image.DecompressionBombWarning):
        raise _too_many_pixels(field) from None
    except Exception:  # decoders of untrusted files raise whatever they like, and their texts may leak memory addresses
        raise _corrupt(field) from None


def _check_kind(opened: PIL.Image.Image, image: Image, field: str) -> None:
    if getattr(opened, "n_frames", 1) != 1:
        raise InvalidInput(
            f"`{field}` must be still images; got {getattr(opened, 'n_frames', 1)} frames in one file.",
            field=field,
            hint="Send one image per timestep.",
        )
    if image.encoding == "png" and image.data[_PNG_BIT_DEPTH] > 8:
        raise InvalidInput(
            f"`{field}` must have 8 bits per channel; got more.",
            field=field,
            hint="Scale the values to 0..255 and save again.",
        )


def _check_pixels(height: int, width: int, field: str) -> None:
    if height < 1 or width < 1:
        raise InvalidInput(
            f"`{field}` must have a height and width of at least 1 pixel; got {height} x {width}.",
            field=field,
            hint="Raw images name their height and width.",
        )
    if height * width > MAX_PIXELS:
        raise _too_many_pixels(field)


def _too_many_pixels(field: str) -> InvalidInput:
    return InvalidInput(
        f"`{field}` may have at most {MAX_PIXELS} pixels each; the header announces more.",
        field=field,
        hint="Scale the image down first.",
    )


def _corrupt(field: str) -> InvalidInput:
    return InvalidInput(
        f"`{field}` must be whole image files; one is corrupt or truncated.",
        field=field,
        hint="Open and save the image again.",
    )
