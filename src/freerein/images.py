"""Decoding and encoding of images: PNG, JPEG, WebP, raw RGB and raw gray.

Untrusted bytes are checked before a decoder runs: an allowed format, bounded chunks and scans, a size below the limits,
a single frame of a PNG or WebP, which may be animated.
Error messages are written here; the decoder's messages are never passed on.
"""

import io
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import numpy.typing as npt
import PIL.ExifTags
import PIL.Image
import PIL.ImageOps
import PIL.JpegImagePlugin

from freerein.errors import InvalidInput, ServiceError, UnsupportedMedia, must_be
from freerein.image_structure import checked_structure
from freerein.types.common import Encoding, Image

MAX_PIXELS = 16_000_000
MAX_SIDE = 16_384  # decoders also allocate memory for each row
MAX_REQUEST_PIXELS = 64_000_000

_RAW_CHANNELS: dict[Encoding, int] = {"raw_rgb8": 3, "raw_gray8": 1}
_PILLOW_FORMATS: dict[Encoding, str] = {"png": "PNG", "jpeg": "JPEG", "webp": "WEBP"}
_PNG_BIT_DEPTH = 24  # offset in a PNG file; checked because Pillow silently reduces 16-bit colour
_ORIENTATIONS_ON_THEIR_SIDE = (5, 6, 7, 8)
_SCALE_DOWN = "Scale the image down first."
_SIGNATURES: tuple[tuple[int, bytes, Encoding], ...] = (
    (0, b"\x89PNG\r\n\x1a\n", "png"),
    (0, b"\xff\xd8\xff", "jpeg"),
    (8, b"WEBP", "webp"),
)


def sniff(data: bytes, *, field: str = "images") -> Encoding:
    """Returns the encoding of a file, from its first bytes; UnsupportedMedia when it is not PNG, JPEG or WebP."""
    for offset, signature, encoding in _SIGNATURES:
        if data[offset : offset + len(signature)] == signature:
            return encoding
    raise UnsupportedMedia(
        f"`{field}` must be PNG, JPEG or WebP files; got {len(data)} bytes of another format.",
        field=field,
        hint="Convert the image first, for example to PNG.",
    )


def decode(image: Image, *, field: str = "images", size: tuple[int, int] | None = None) -> npt.NDArray[np.uint8]:
    """Returns the pixels of an image.

    Colour (palette, CMYK, alpha) becomes RGB without alpha, 8-bit gray stays gray, and the EXIF orientation of a JPEG
    is applied. Of a JPEG that holds several pictures, as phones and cameras write them, it is the first.

    Args:
        image: The image.
        field: Dotted name of the image in the request, for errors.
        size: Height and width that the image must have; None for any. An image of another size is not decoded.

    Returns:
        uint8 (height, width, channels), channels 1 or 3; read-only for the raw encodings.

    Raises:
        UnsupportedMedia: The data is not in its declared encoding.
        InvalidInput: Corrupt, truncated, animated, empty, more than 8 bits per channel, not of its declared size or of
            `size`, more than `MAX_PIXELS` pixels or `MAX_SIDE` rows or columns, or of too many chunks or scans.
    """
    if image.encoding in _RAW_CHANNELS:
        _check_pixels(image.height, image.width, field)
        _check_size((image.height, image.width), size, field)
        return _decode_raw(image, field)
    with _open(image, field) as opened:
        height, width = found = _upright_size(opened, image.encoding)
        _check_size(found, (image.height or height, image.width or width), field)
        _check_size(found, size, field)
        return _pixels(opened, image.encoding)


def pixel_count(image: Image, *, field: str = "images") -> int:
    """Returns the number of pixels of an image, from its header.

    Raises:
        UnsupportedMedia: The data is not in its declared encoding.
        InvalidInput: The header is corrupt, or declares more than `MAX_PIXELS` pixels or `MAX_SIDE` rows or columns.
    """
    if image.encoding in _RAW_CHANNELS:
        _check_pixels(image.height, image.width, field)
        return image.height * image.width
    with _open(image, field) as opened:
        return opened.width * opened.height


def check_frames(frames: npt.NDArray[Any], *, axis: str) -> npt.NDArray[np.uint8]:
    """Returns the `frames` of a request if they are uint8 (axis, H, W, 1 or 3) and not empty; else InvalidInput."""
    if frames.dtype != np.uint8 or frames.ndim != 4 or frames.shape[3] not in (1, 3) or 0 in frames.shape:
        rule = f"UINT8 of shape ({axis}, H, W, C), {axis} at least 1 and C 1 or 3"
        hint = "Put channels last, and scale floats to 0..255."
        raise must_be("frames", rule, f"{frames.dtype} {frames.shape}", hint=hint)
    _check_pixels(frames.shape[1], frames.shape[2], "frames")
    return frames


def resize(frames: npt.NDArray[np.uint8], size: tuple[int, int]) -> npt.NDArray[np.uint8]:
    """Returns frames (T, H, W, C) at another height and width, each pixel the mean of those that it covers."""
    height, width = size
    resized = np.empty((len(frames), height, width, frames.shape[-1]), np.uint8)
    for t, frame in enumerate(frames):
        pixels = PIL.Image.fromarray(frame[..., 0] if frame.shape[-1] == 1 else frame)
        resized[t] = np.asarray(pixels.resize((width, height), PIL.Image.Resampling.BOX)).reshape(resized.shape[1:])
    return resized


def check_one_form(*, has_frames: bool, has_images: bool) -> None:
    """Raises InvalidInput unless exactly one of a request's `frames` and `images` is given."""
    if has_frames == has_images:
        raise InvalidInput(
            f"Exactly one of `frames` and `images` must be given; got {'both' if has_images else 'neither'}.",
            field="frames",
            hint="Send `images` over REST, `frames` over gRPC.",
        )


def check_total_pixels(total: int, *, hint: str, field: str = "images") -> None:
    """Raises InvalidInput when the images in a request's field have too many pixels together."""
    if total > MAX_REQUEST_PIXELS:
        raise must_be(field, f"at most {MAX_REQUEST_PIXELS} pixels in total", total, hint=hint)


def encode(pixels: npt.NDArray[np.uint8], *, encoding: Encoding = "png", camera: str = "") -> Image:
    """Returns pixels, uint8 (height, width, 1 or 3), as an encoded image.

    Raises InvalidInput for another array, or one whose channels do not match a raw encoding.
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
    expected = image.height * image.width * channels
    if len(image.data) != expected:
        rule = f"height x width x {channels} = {expected} bytes"
        raise must_be(field, rule, len(image.data), hint="Send the rows without padding.")
    return np.frombuffer(image.data, np.uint8).reshape(image.height, image.width, channels)


def _pixels(opened: PIL.Image.Image, encoding: Encoding) -> npt.NDArray[np.uint8]:
    upright = PIL.ImageOps.exif_transpose(opened) if encoding == "jpeg" else opened
    if "transparency" in upright.info:  # converted in two steps: Pillow warns about one
        upright = upright.convert("LA" if upright.mode in ("1", "L") else "RGBA")
    pixels = np.asarray(upright.convert("L" if upright.mode in ("1", "L", "LA") else "RGB"))
    return pixels.reshape(pixels.shape[0], pixels.shape[1], -1)


def _upright_size(opened: PIL.Image.Image, encoding: Encoding) -> tuple[int, int]:
    """Returns the height and width that an opened file will have when decoded."""
    orientation = opened.getexif().get(PIL.ExifTags.Base.Orientation) if encoding == "jpeg" else None
    if orientation in _ORIENTATIONS_ON_THEIR_SIDE:
        return opened.width, opened.height
    return opened.height, opened.width


def _check_size(found: tuple[int, int], expected: tuple[int, int] | None, field: str) -> None:
    if expected is not None and found != expected:
        rule = f"of the expected height and width, {expected[0]} x {expected[1]}"
        hint = "Scale the image. Leave height and width 0 for encoded files."
        raise must_be(field, rule, f"{found[0]} x {found[1]}", hint=hint)


@contextmanager
def _open(image: Image, field: str) -> Iterator[PIL.Image.Image]:
    """Opens a file lazily after the checks, and replaces whatever the decoder raises."""
    if sniff(image.data, field=field) != image.encoding:
        raise UnsupportedMedia(
            f"`{field}` must be in its declared encoding, {image.encoding}; its first bytes are of another.",
            field=field,
            hint="Declare the encoding of the file.",
        )
    try:
        data = checked_structure(image.data, image.encoding, field=field)
        with _lazily_opened(data, image.encoding) as opened:
            _check_pixels(opened.height, opened.width, field)
            _check_kind(opened, image, field)
            yield opened
    except ServiceError:
        raise
    except (PIL.Image.DecompressionBombError, PIL.Image.DecompressionBombWarning):
        raise _too_many_pixels(field) from None
    except Exception:  # decoders raise any type, and their messages may hold memory addresses
        hint = "Open and save the image again."
        raise must_be(field, "complete image files", "one that is corrupt or truncated", hint=hint) from None


def _lazily_opened(data: bytes, encoding: Encoding) -> PIL.Image.Image:
    if encoding == "jpeg":  # not by `PIL.Image.open`: of phones and cameras it would also open the second picture
        return PIL.JpegImagePlugin.JpegImageFile(io.BytesIO(data))
    return PIL.Image.open(io.BytesIO(data), formats=[_PILLOW_FORMATS[encoding]])


def _check_kind(opened: PIL.Image.Image, image: Image, field: str) -> None:
    count = getattr(opened, "n_frames", 1)
    if count != 1:
        raise must_be(field, "still images", f"{count} frames in one file", hint="Send one image per timestep.")
    if image.encoding == "png" and image.data[_PNG_BIT_DEPTH] > 8:
        raise must_be(field, "of 8 bits per channel", "more", hint="Scale the values to 0..255 and save again.")


def _check_pixels(height: int, width: int, field: str) -> None:
    if height < 1 or width < 1:
        rule = "at least 1 pixel high and wide"
        raise must_be(field, rule, f"{height} x {width}", hint="Raw images need height and width.")
    if max(height, width) > MAX_SIDE:
        raise must_be(field, f"of at most {MAX_SIDE} rows and columns each", f"{height} x {width}", hint=_SCALE_DOWN)
    if height * width > MAX_PIXELS:
        raise _too_many_pixels(field)


def _too_many_pixels(field: str) -> InvalidInput:
    return must_be(field, f"of at most {MAX_PIXELS} pixels each", "more", hint=_SCALE_DOWN)
