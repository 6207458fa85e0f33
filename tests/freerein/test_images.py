"""Untrusted image files: documented pixels, or an error of ours."""

import io
import struct
import threading
import warnings
import zlib

import numpy as np
import numpy.typing as npt
import PIL.Image
import pytest
from hypothesis import given
from hypothesis import strategies as st

from freerein import images
from freerein.errors import InvalidInput, ServiceError, UnsupportedMedia
from freerein.types.common import Encoding, Image

FILES: tuple[Encoding, ...] = ("png", "jpeg", "webp")


def save(image: PIL.Image.Image, file_format: str, **options: object) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, file_format, **options)
    return buffer.getvalue()


def file(encoding: Encoding, data: bytes) -> Image:
    return Image(encoding, 0, 0, data)


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(width: int, height: int, *, depth: int, colour: int, raw: bytes) -> bytes:
    """Returns a PNG written by hand: Pillow writes no 16-bit colour and no lying headers."""
    header = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(raw)) + chunk(b"IEND", b"")


def gray_jpeg(pixels: npt.NDArray[np.uint8], orientation: int) -> bytes:
    exif = PIL.Image.Exif()
    exif[0x0112] = orientation
    return save(PIL.Image.fromarray(pixels), "JPEG", exif=exif, quality=100)


# --- what is documented to work


@pytest.mark.parametrize("encoding", ["png", "raw_rgb8"])
def test_colour_comes_back_as_it_went(encoding: Encoding) -> None:
    pixels = np.arange(2 * 3 * 3, dtype=np.uint8).reshape(2, 3, 3)
    np.testing.assert_array_equal(images.decode(images.encode(pixels, encoding=encoding)), pixels)


@pytest.mark.parametrize("encoding", ["png", "raw_gray8"])
def test_gray_stays_gray(encoding: Encoding) -> None:
    pixels = np.arange(6, dtype=np.uint8).reshape(2, 3, 1)
    np.testing.assert_array_equal(images.decode(images.encode(pixels, encoding=encoding)), pixels)


@pytest.mark.parametrize("encoding", ["jpeg", "webp"])
def test_a_lossy_file_is_close_to_what_went(encoding: Encoding) -> None:
    pixels = np.full((16, 16, 3), (200, 100, 50), np.uint8)
    back = images.decode(images.encode(pixels, encoding=encoding))
    assert back.shape == pixels.shape
    assert np.abs(back.astype(int) - pixels).max() <= 4


QUADRANTS = np.kron(np.array([[0, 80], [160, 240]], np.uint8), np.ones((16, 16), np.uint8))
UPRIGHT = {  # EXIF's table: which way the stored rows and columns run
    1: QUADRANTS,
    2: QUADRANTS[:, ::-1],
    3: QUADRANTS[::-1, ::-1],
    4: QUADRANTS[::-1],
    5: QUADRANTS.T,
    6: np.rot90(QUADRANTS, -1),
    7: QUADRANTS[::-1, ::-1].T,
    8: np.rot90(QUADRANTS),
}


@pytest.mark.fault("S4")
@pytest.mark.parametrize("orientation", UPRIGHT)
def test_exif_orientation_is_applied_once(orientation: int) -> None:
    pixels = images.decode(file("jpeg", gray_jpeg(QUADRANTS, orientation)))
    assert np.abs(pixels[:, :, 0].astype(int) - UPRIGHT[orientation]).max() <= 2


@pytest.mark.parametrize("orientation", UPRIGHT)
def test_a_turned_file_is_as_high_as_it_is_wide_on_disk(orientation: int) -> None:
    size = (24, 8) if orientation > 4 else (8, 24)
    stored = gray_jpeg(np.zeros((8, 24), np.uint8), orientation)
    assert images.decode(file("jpeg", stored), size=size).shape == (*size, 1)


@pytest.mark.fault("S4")
@pytest.mark.parametrize(
    ("mode", "colour", "expected"),
    [
        ("CMYK", (0, 255, 255, 0), [255, 0, 0]),
        ("CMYK", (0, 0, 0, 255), [0, 0, 0]),
        ("L", 90, [90]),
    ],
)
def test_the_colours_of_a_jpeg_become_rgb_or_stay_gray(
    mode: str, colour: int | tuple[int, ...], expected: list[int]
) -> None:
    data = save(PIL.Image.new(mode, (16, 16), colour), "JPEG", quality=100)
    assert np.abs(images.decode(file("jpeg", data))[8, 8].astype(int) - expected).max() <= 3


@pytest.mark.parametrize(
    ("mode", "colour", "expected"),
    [
        ("1", 1, [255]),
        ("LA", (90, 10), [90]),
        ("RGBA", (10, 20, 30, 0), [10, 20, 30]),
        ("RGB", (10, 20, 30), [10, 20, 30]),
    ],
)
def test_alpha_is_dropped_and_bits_become_bytes(mode: str, colour: int | tuple[int, ...], expected: list[int]) -> None:
    data = save(PIL.Image.new(mode, (2, 2), colour), "PNG")
    assert images.decode(file("png", data))[0, 0].tolist() == expected


@pytest.mark.fault("S4")
@pytest.mark.parametrize("transparency", [None, 0, b"\x00\x80"])
def test_a_palette_becomes_rgb_whatever_of_it_is_transparent(transparency: int | bytes | None) -> None:
    palette = PIL.Image.new("P", (2, 1))
    palette.putpalette([10, 20, 30, 40, 50, 60])
    palette.putpixel((1, 0), 1)
    data = save(palette, "PNG", **({} if transparency is None else {"transparency": transparency}))
    assert images.decode(file("png", data)).tolist() == [[[10, 20, 30], [40, 50, 60]]]


def test_a_gray_png_with_a_transparent_level_stays_gray() -> None:
    data = save(PIL.Image.new("L", (1, 1), 7), "PNG", transparency=7)
    assert images.decode(file("png", data)).tolist() == [[[7]]]


def test_one_pixel_and_the_longest_row_and_column_are_images() -> None:
    assert images.decode(file("png", save(PIL.Image.new("L", (1, 1)), "PNG"))).shape == (1, 1, 1)
    assert images.decode(file("png", save(PIL.Image.new("RGB", (16_384, 1)), "PNG"))).shape == (1, 16_384, 3)
    assert images.decode(file("png", save(PIL.Image.new("RGB", (1, 16_384)), "PNG"))).shape == (16_384, 1, 3)


@pytest.mark.parametrize("encoding", ["png", "webp"])
def test_the_orientation_of_another_file_than_a_jpeg_is_not_applied(encoding: Encoding) -> None:
    exif = PIL.Image.Exif()
    exif[0x0112] = 6
    data = save(PIL.Image.fromarray(QUADRANTS[:, :24]).convert("RGB"), encoding, exif=exif, lossless=True)
    pixels = images.decode(file(encoding, data), size=(32, 24))
    np.testing.assert_array_equal(pixels[:, :, 0], QUADRANTS[:, :24])


# --- what is refused


@pytest.mark.fault("S4")
@pytest.mark.parametrize(("colour", "channels"), [(0, 1), (2, 3), (4, 2), (6, 4)])
def test_more_than_eight_bits_per_channel_are_refused(colour: int, channels: int) -> None:
    data = png(1, 1, depth=16, colour=colour, raw=b"\0" + b"\x12\x34" * channels)
    with pytest.raises(InvalidInput, match="8 bits"):
        images.decode(file("png", data))


@pytest.mark.fault("F11")
def test_only_a_header_that_comes_first_and_once_says_how_many_bits_there_are() -> None:
    whole = png(1, 1, depth=16, colour=2, raw=b"\0" + b"\x12\x34" * 3)
    header, text = whole[8:33], chunk(b"tEXt", bytes(9))
    behind_another = whole[:8] + chunk(b"IHDR", header[8:16] + b"\x08" + header[17:21]) + whole[8:]
    for data in (whole[:8] + text + whole[8:], behind_another):
        with pytest.raises(InvalidInput, match="corrupt"):
            images.decode(file("png", data))


@pytest.mark.fault("S4")
@pytest.mark.parametrize("encoding", ["png", "webp"])
def test_an_animation_is_refused(encoding: Encoding) -> None:
    frames = [PIL.Image.new("RGB", (4, 4), colour) for colour in ("red", "green", "blue")]
    data = save(frames[0], encoding, save_all=True, append_images=frames[1:], duration=10)
    with pytest.raises(InvalidInput, match="3 frames"):
        images.decode(file(encoding, data))


@pytest.mark.parametrize("orientation", [1, 6])
def test_a_jpeg_of_a_phone_or_a_camera_is_its_first_picture(orientation: int) -> None:
    exif = PIL.Image.Exif()
    exif[0x0112] = orientation
    pictures = [PIL.Image.new("RGB", size, colour) for size, colour in (((16, 8), "red"), ((8, 4), "blue"))]
    data = save(pictures[0], "MPO", save_all=True, append_images=pictures[1:], exif=exif)
    pixels = images.decode(file("jpeg", data))
    assert pixels.shape == ((8, 16, 3) if orientation == 1 else (16, 8, 3))
    assert images.pixel_count(file("jpeg", data)) == 16 * 8
    assert np.abs(pixels.astype(int) - (255, 0, 0)).max() <= 3


@pytest.mark.parametrize(("width", "height"), [(4_001, 4_000), (13_000, 13_000), (16_384, 977)])
def test_too_many_pixels_are_refused_by_the_header_alone(width: int, height: int) -> None:
    bomb = file("png", png(width, height, depth=8, colour=0, raw=b"\0"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PIL.Image.DecompressionBombWarning)
        for read in (images.decode, images.pixel_count):
            with pytest.raises(InvalidInput, match="at most 16000000 pixels"):
                read(bomb)


@pytest.mark.fault("F6")
@pytest.mark.parametrize(("width", "height"), [(16_385, 1), (1, 16_385), (20_000, 20_000), (2**31 - 1, 1)])
def test_too_long_a_side_is_refused_by_the_header_alone(width: int, height: int) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PIL.Image.DecompressionBombWarning)
        for read in (images.decode, images.pixel_count):
            with pytest.raises(InvalidInput, match=r"at most (16384 rows and columns|16000000 pixels)"):
                read(file("png", png(width, height, depth=8, colour=0, raw=b"\0")))
    with pytest.raises(InvalidInput, match="at most 16384 rows and columns"):
        images.pixel_count(Image("raw_gray8", height, width, b""))


def test_sixteen_million_pixels_are_allowed_and_no_more() -> None:
    assert images.pixel_count(Image("raw_gray8", 4_000, 4_000, b"")) == 16_000_000
    frames = np.broadcast_to(np.uint8(0), (1, 4_000, 4_000, 1))
    assert images.check_frames(frames, axis="T") is frames
    height, width = 1_206, 13_267  # the next product of two sides: 16 000 002
    with pytest.raises(InvalidInput, match="at most 16000000 pixels"):
        images.pixel_count(Image("raw_gray8", height, width, b""))
    with pytest.raises(InvalidInput, match="at most 16000000 pixels"):
        images.check_frames(np.broadcast_to(np.uint8(0), (1, height, width, 1)), axis="T")


@pytest.mark.parametrize(("width", "height"), [(0, 0), (0, 5), (5, 0)])
def test_an_image_without_pixels_is_refused(width: int, height: int) -> None:
    for image in (
        file("png", png(width, height, depth=8, colour=0, raw=b"\0")),
        Image("raw_gray8", height, width, b""),
    ):
        with pytest.raises(InvalidInput):
            images.decode(image)


@pytest.mark.parametrize("other", ["GIF", "TIFF", "PPM", "BMP", "ICO", "PDF", "EPS"])
@pytest.mark.parametrize("claimed", FILES)
def test_a_format_that_is_not_served_is_refused_whatever_it_claims_to_be(other: str, claimed: Encoding) -> None:
    data = save(PIL.Image.new("RGB", (16, 16)), other)
    for read in (images.decode, images.pixel_count):
        with pytest.raises(UnsupportedMedia):
            read(file(claimed, data))


@pytest.mark.parametrize("other", ["GIF", "TIFF", "PPM", "BMP", "PDF", "EPS"])
@pytest.mark.parametrize("claimed", FILES)
def test_a_signature_in_front_of_another_format_does_not_reach_its_decoder(other: str, claimed: Encoding) -> None:
    own = save(PIL.Image.new("RGB", (16, 16)), claimed)[:12]
    with pytest.raises(InvalidInput, match="corrupt"):
        images.decode(file(claimed, own + save(PIL.Image.new("RGB", (16, 16)), other)))


def test_an_encoding_that_is_not_the_files_is_refused() -> None:
    with pytest.raises(UnsupportedMedia, match="jpeg"):
        images.decode(file("jpeg", save(PIL.Image.new("L", (2, 2)), "PNG")))


def test_a_size_that_is_not_the_files_is_refused() -> None:
    data = save(PIL.Image.new("L", (2, 3)), "PNG")
    assert images.decode(Image("png", 3, 2, data)).shape == (3, 2, 1)
    with pytest.raises(InvalidInput, match="2 x 2"):
        images.decode(Image("png", 2, 2, data))
    with pytest.raises(InvalidInput, match="2 x 2; got 3 x 2"):
        images.decode(Image("raw_gray8", 3, 2, bytes(6)), size=(2, 2))


@pytest.mark.parametrize(("is_given", "got"), [(False, "neither"), (True, "both")])
def test_frames_and_images_are_not_given_together_nor_left_out(is_given: bool, got: str) -> None:
    images.check_one_form(has_frames=is_given, has_images=not is_given)
    with pytest.raises(InvalidInput, match=f"got {got}") as refusal:
        images.check_one_form(has_frames=is_given, has_images=is_given)
    assert refusal.value.field == "frames"


@given(st.integers(0, 2**32 - 1), st.integers(0, 2**32 - 1), st.binary(max_size=12))
def test_a_raw_image_is_exactly_as_long_as_it_says(height: int, width: int, data: bytes) -> None:
    try:
        pixels = images.decode(Image("raw_rgb8", height, width, data))
    except InvalidInput:
        assert height * width * 3 != len(data) or not data
    else:
        assert pixels.tobytes() == data


WHOLE = {
    encoding: save(PIL.Image.fromarray(np.arange(8 * 8 * 3, dtype=np.uint8).reshape(8, 8, 3)), encoding)
    for encoding in FILES
}


# --- what is costly


def with_parts(encoding: Encoding, parts: int, size: int) -> bytes:
    """Returns a whole file of so many chunks or segments, most of them of a size and without meaning."""
    data, content = WHOLE[encoding], bytes(size)
    if encoding == "png":  # IHDR, IDAT, IEND
        return data[:33] + chunk(b"teSt", content) * (parts - 3) + data[33:]
    if encoding == "jpeg":
        own = data[: data.index(b"\xff\xda")].count(b"\xff")  # each begins one, but the first; and the scan
        return data[:2] + (b"\xff\xfe" + struct.pack(">H", size + 2) + content) * (parts - own) + data[2:]
    extended = b"VP8X" + struct.pack("<I", 10) + bytes(4) + b"\7\0\0" * 2
    body = (
        b"WEBP" + extended + data[12:] + (b"teSt" + struct.pack("<I", size) + content + bytes(size % 2)) * (parts - 2)
    )
    return b"RIFF" + struct.pack("<I", len(body)) + body


@pytest.mark.fault("F6")
@pytest.mark.parametrize("encoding", FILES)
@pytest.mark.parametrize(("size", "most"), [(0, 64), (1_101, 256)])
def test_a_file_may_have_so_many_parts_and_no_more(encoding: Encoding, size: int, most: int) -> None:
    assert images.decode(file(encoding, with_parts(encoding, most, size))).shape == (8, 8, 3)
    more = file(encoding, with_parts(encoding, most + 1, size))
    if encoding == "png" and size:  # pixels, too, come in chunks
        assert images.decode(more).shape == (8, 8, 3)
    else:
        with pytest.raises(InvalidInput, match=f"at most {most} (chunks|segments) in"):
            images.decode(more)


def test_a_file_may_have_one_part_more_for_each_kib() -> None:
    data = with_parts("jpeg", 65, 0)
    assert isinstance(decoded("jpeg", data.ljust(1024, b"\0")), np.ndarray)
    assert isinstance(decoded("jpeg", data.ljust(1023, b"\0")), InvalidInput)


@pytest.mark.parametrize("encoding", ["png", "webp"])
def test_a_chunk_that_is_only_begun_is_one(encoding: Encoding) -> None:
    with pytest.raises(InvalidInput, match="at most 64 chunks"):
        images.decode(file(encoding, with_parts(encoding, 64, 0) + bytes(8)))


@pytest.mark.parametrize("marker", [0x01, 0xBF, 0xC8, 0xD0, 0xD8, 0xF0, 0xFD])
def test_a_segment_whose_length_decoders_disagree_on_is_refused(marker: int) -> None:
    image = file("jpeg", WHOLE["jpeg"][:2] + bytes([0xFF, marker, 0, 2]) + WHOLE["jpeg"][2:])
    for read in (images.decode, images.pixel_count):
        with pytest.raises(InvalidInput, match="corrupt"):
            read(image)


@pytest.mark.fault("F3")
def test_a_jpeg_may_have_so_many_scans_and_no_more() -> None:
    data = save(PIL.Image.new("CMYK", (16, 16)), "JPEG", progressive=True)
    scan = data.rindex(b"\xff\xda")
    last, scans = data[scan:-2], data.count(b"\xff\xda")
    assert scans == 18  # the most that libjpeg writes by itself
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for more, allowed in ((32 - scans, True), (33 - scans, False)):
            for comment in (b"", b"\xff\xfe\0\4\xff\xd9"):  # which looks like the end
                outcome = decoded("jpeg", data[:-2] + comment + last * more + b"\xff\xd9" + b"\xff\xda" * 100)
                assert isinstance(outcome, np.ndarray) is allowed
                assert allowed or "at most 32 scans in" in str(outcome)


def test_a_jpeg_may_have_some_bytes_of_fill_before_a_marker() -> None:
    data = save(PIL.Image.new("L", (8, 8)), "JPEG")
    for fill, allowed in ((1, True), (1024, True), (1025, False)):
        outcome = decoded("jpeg", data[:2] + b"\xff" * fill + data[2:])
        assert isinstance(outcome, np.ndarray) is allowed


@pytest.mark.fault("F3")
def test_a_file_of_another_size_than_expected_is_not_decoded() -> None:
    broken = gray_jpeg(np.arange(192, dtype=np.uint8).reshape(8, 24), 6)[:-20]
    with pytest.raises(InvalidInput, match="8 x 24; got 24 x 8"):
        images.decode(file("jpeg", broken), size=(8, 24))
    with pytest.raises(InvalidInput, match="8 x 24; got 24 x 8"):
        images.decode(Image("jpeg", 8, 24, broken))
    with pytest.raises(InvalidInput, match="corrupt"):
        images.decode(file("jpeg", broken), size=(24, 8))


# --- what is broken


def decoded(encoding: Encoding, data: bytes) -> npt.NDArray[np.uint8] | ServiceError:
    try:
        return images.decode(file(encoding, data))
    except ServiceError as error:
        return error


@pytest.mark.fault("S3")
@pytest.mark.parametrize("encoding", FILES)
def test_a_file_cut_at_any_byte_is_an_error_of_ours(encoding: Encoding) -> None:
    pixels = images.decode(file(encoding, WHOLE[encoding]))
    for cut in range(len(WHOLE[encoding])):
        outcome = decoded(encoding, WHOLE[encoding][:cut])
        if isinstance(outcome, ServiceError):
            assert "images" in outcome.detail
            assert outcome.http_status in (415, 422)
        else:  # what follows the last row may be missing
            assert outcome.shape == pixels.shape


@pytest.mark.parametrize("encoding", FILES)
@given(data=st.data())
def test_a_corrupt_file_is_pixels_or_an_error_with_a_text_of_ours(encoding: Encoding, data: st.DataObject) -> None:
    corrupt = bytearray(WHOLE[encoding])
    for _ in range(data.draw(st.integers(1, 4))):
        corrupt[data.draw(st.integers(0, len(corrupt) - 1))] = data.draw(st.integers(0, 255))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        outcome = decoded(encoding, bytes(corrupt))
    assert not isinstance(outcome, ServiceError) or outcome.detail.startswith("`images` m")


def test_a_corrupt_orientation_does_not_spoil_the_pixels() -> None:
    data = gray_jpeg(QUADRANTS, 6).replace(b"Exif\0\0II*\0", b"Exif\0\0II*\xff").replace(b"Exif\0\0MM", b"Exif\0\0XX")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert images.decode(file("jpeg", data)).shape == (32, 32, 1)


def test_decoding_on_many_threads_leaves_the_warning_filters_alone() -> None:
    before = list(warnings.filters)
    image = file("png", WHOLE["png"])

    def decode_many() -> None:
        for _ in range(100):
            images.decode(image)

    threads = [threading.Thread(target=decode_many) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert list(warnings.filters) == before


# --- encoding


@pytest.mark.parametrize(
    "pixels",
    [
        np.zeros((2, 2, 3), np.float32),
        np.zeros((3, 2, 2), np.uint8),
        np.zeros((2, 2), np.uint8),
        np.zeros((2, 2, 4), np.uint8),
    ],
)
def test_only_8_bit_gray_or_colour_with_channels_last_is_encoded(pixels: npt.NDArray[np.uint8]) -> None:
    with pytest.raises(InvalidInput, match="got"):
        images.encode(pixels)


def test_a_raw_encoding_must_fit_the_channels() -> None:
    with pytest.raises(InvalidInput, match="raw_rgb8 holds 3"):
        images.encode(np.zeros((2, 2, 1), np.uint8), encoding="raw_rgb8")
