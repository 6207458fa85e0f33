"""Video: what a decoder returns, and what becomes of files that are damaged, hostile, or no video."""

import os
import select
import signal
import struct
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import psutil
import pytest
from tests.child_processes import children_running

from freerein.errors import InvalidInput, Unimplemented, UnsupportedMedia
from freerein.video import Video, VideoBounds, open_video

EncodeVideo = Callable[..., bytes]
FRAMES, HEIGHT, WIDTH = 12, 64, 96


@pytest.fixture(scope="module")
def colours() -> npt.NDArray[np.uint8]:
    """uint8 (T, H, W, 3); the right half is black, the left half has another red every frame."""
    pixels = np.zeros((FRAMES, HEIGHT, WIDTH, 3), np.uint8)
    pixels[:, :, : WIDTH // 2, 0] = np.linspace(40, 250, FRAMES, dtype=np.uint8)[:, None, None]
    return pixels


@pytest.fixture(scope="module")
def h264(encode_video: EncodeVideo, colours: npt.NDArray[np.uint8]) -> bytes:
    return encode_video(colours)


@pytest.fixture(scope="module")
def long_video(encode_video: EncodeVideo) -> bytes:
    """More than fits between a decoder and its reader: the decoder waits until it is read."""
    return encode_video(np.zeros((100, 128, 128, 3), np.uint8))


def decoded(source: bytes | Path, **options: object) -> npt.NDArray[np.uint8]:
    """Returns all frames of a video, uint8 (T, H, W, C)."""
    with open_video(source, **options) as video:  # type: ignore[arg-type]
        return np.stack([frame.pixels for frame in video])


def decoders() -> list[psutil.Process]:
    return children_running("freerein.video.decoder")


@pytest.mark.parametrize(
    ("encoder", "codec"),
    [
        ("libx264", "h264"),
        ("libx265", "hevc"),
        ("libsvtav1", "av1"),
        ("libvpx-vp9", "vp9"),
        ("mpeg4", "mpeg4"),
        ("mjpeg", "mjpeg"),
    ],
)
def test_frames_come_in_order_with_their_times(
    encode_video: EncodeVideo, colours: npt.NDArray[np.uint8], encoder: str, codec: str
) -> None:
    with open_video(encode_video(colours, codec=encoder)) as video:
        frames = list(video)
    info = video.info
    assert (info.codec, info.height, info.width) == (codec, HEIGHT, WIDTH)
    assert (info.fps, info.frame_count) == (10.0, FRAMES)
    assert [frame.time_s for frame in frames] == pytest.approx(np.arange(FRAMES) / 10)
    shown = np.stack([frame.pixels for frame in frames])
    assert shown.dtype == np.uint8
    assert np.abs(shown[:, :, 8:40].astype(int) - colours[:, :, 8:40]).max() <= 16


@pytest.mark.parametrize("encoder", ["libx264", "libvpx-vp9"])
def test_frames_from_a_time_on_are_those_of_the_whole_video(encode_video: EncodeVideo, encoder: str) -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (300, 64, 64, 3), np.uint8)  # more than one group of pictures
    video = encode_video(pixels, codec=encoder)
    with open_video(video) as whole, open_video(video, start_s=27.95) as late, open_video(video, start_s=99) as beyond:
        expected = list(whole)
        for found, start in ((list(late), 280), (list(beyond), 299)):
            assert [frame.time_s for frame in found] == [frame.time_s for frame in expected[start:]]
            for one, other in zip(found, expected[start:], strict=True):
                np.testing.assert_array_equal(one.pixels, other.pixels)


def test_a_file_is_read_as_its_contents_are(tmp_path: Path, h264: bytes) -> None:
    path = tmp_path / "demo.mp4"
    path.write_bytes(h264)
    np.testing.assert_array_equal(decoded(path), decoded(h264))


def test_frames_are_resized_and_gray_when_asked(h264: bytes) -> None:
    colour, gray = decoded(h264), decoded(h264, channels=1)
    luma = colour.astype(float) @ [0.299, 0.587, 0.114]
    assert gray.shape == (FRAMES, HEIGHT, WIDTH, 1)
    assert np.abs(gray[..., 0] - luma).max() <= 0.501
    assert decoded(h264, size=(32, 40)).shape == (FRAMES, 32, 40, 3)


@pytest.mark.parametrize(
    ("matrix", "height", "corner"),
    [
        ((1, 0, 0, -1), HEIGHT, "bottom left"),
        ((-1, 0, 0, -1), HEIGHT, "bottom right"),
        ((0, 1, 1, 0), WIDTH, "top left"),
        ((0, 1, -1, 0), WIDTH, "top right"),
        ((0, -1, 1, 0), WIDTH, "bottom left"),
    ],
)
def test_a_video_is_turned_and_mirrored_as_its_display_matrix_says(
    encode_video: EncodeVideo, matrix: tuple[int, int, int, int], height: int, corner: str
) -> None:
    lit = np.zeros((1, HEIGHT, WIDTH, 3), np.uint8)
    lit[:, : HEIGHT // 2, : WIDTH // 2] = 200
    is_resized = corner == "top right"
    options = {"size": (40, 20), "channels": 1} if is_resized else {}
    (frame,) = decoded(with_display_matrix(encode_video(lit), matrix), **options)
    top, left = frame[: len(frame) // 2, :, 0].mean() > 40, frame[:, : frame.shape[1] // 2, 0].mean() > 40
    assert f"{'top' if top else 'bottom'} {'left' if left else 'right'}" == corner
    assert len(frame) == (40 if is_resized else height)


def with_display_matrix(video: bytes, matrix: tuple[int, int, int, int]) -> bytes:
    """Returns a file of one track whose display matrix has the numbers a, b, c and d."""
    a, b, c, d = matrix
    own, other = (
        struct.pack(">9i", *(n << 16 for n in each), 0, 0, 1 << 30) for each in ((1, 0, 0, 0, 1, 0), (a, b, 0, c, d, 0))
    )
    at = video.index(own, video.index(b"tkhd"))
    return video[:at] + other + video[at + len(own) :]


def test_a_quicktime_file_need_not_begin_with_its_type(
    encode_video: EncodeVideo, colours: npt.NDArray[np.uint8]
) -> None:
    movie = encode_video(colours, container="mov")
    assert len(decoded(movie.replace(b"ftyp", b"wide", 1))) == FRAMES


def test_the_size_of_the_last_box_may_be_open(h264: bytes) -> None:
    at = h264.rindex(b"moov") - 4
    assert len(decoded(h264[:at] + bytes(4) + h264[at + 4 :])) == FRAMES


def test_a_decoder_has_no_environment_and_ends_when_its_video_is_left(
    monkeypatch: pytest.MonkeyPatch, long_video: bytes
) -> None:
    monkeypatch.setenv("FREEREIN_TOKEN", "secret")
    with open_video(long_video) as video:
        assert video.info.codec == "h264"
        next(iter(video))
        (decoder,) = decoders()
        assert "FREEREIN_TOKEN" not in decoder.environ()
    assert not decoder.is_running()


@pytest.mark.fault("S10")
@pytest.mark.parametrize("cut", [0.1, 0.5, 0.9, 0.999])
def test_a_truncated_file_is_refused(h264: bytes, cut: float) -> None:
    with pytest.raises(InvalidInput, match="truncated"):
        decoded(h264[: int(len(h264) * cut)])


@pytest.mark.fault("S10")
def test_a_damaged_file_is_refused_or_decoded(h264: bytes) -> None:
    rng = np.random.default_rng(0)
    damaged = np.frombuffer(h264, np.uint8).copy()
    places = rng.integers(40, len(damaged), 20)
    damaged[places] = rng.integers(0, 256, len(places))
    try:
        frames = decoded(damaged.tobytes())
    except (UnsupportedMedia, InvalidInput):
        return
    assert 1 <= len(frames) <= FRAMES


@pytest.mark.fault("S10")
@pytest.mark.parametrize(
    "contents",
    [b"", b"GIF89a" + bytes(1000), b"\0\0\0\x18ftypmp42" + bytes(12), bytes(1000), b"\0\0\0\0mdat" + bytes(1000)],
)
def test_what_is_no_video_is_refused(contents: bytes) -> None:
    with pytest.raises((UnsupportedMedia, InvalidInput)):
        decoded(contents)


@pytest.mark.fault("S10")
@pytest.mark.parametrize(
    ("codec", "container", "words"),
    [("mpeg2video", "mp4", "it has the codec mpeg2video"), ("libx264", "matroska", "another format")],
)
def test_another_codec_or_container_is_refused_by_file_and_codec(
    encode_video: EncodeVideo, colours: npt.NDArray[np.uint8], codec: str, container: str, words: str
) -> None:
    with pytest.raises(UnsupportedMedia, match=rf"`clip\.mov` must .*{words}"):
        decoded(encode_video(colours, codec=codec, container=container), field="clip.mov")


@pytest.mark.fault("S10")
def test_what_is_no_regular_file_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.mp4")
    (tmp_path / "device.mp4").symlink_to("/dev/zero")
    for name, kind in (("pipe", "a pipe"), ("device", "a device")):
        with pytest.raises(InvalidInput, match=f"must be a regular file; it is {kind}"):
            decoded(tmp_path / f"{name}.mp4")


@pytest.mark.fault("S10")
def test_a_small_file_with_huge_frames_is_refused(encode_video: EncodeVideo) -> None:
    bomb = encode_video(np.zeros((1, 2306, 4096, 3), np.uint8))
    assert len(bomb) < 100_000
    with pytest.raises(InvalidInput, match="pixels"):
        decoded(bomb)


@pytest.mark.fault("S10")
@pytest.mark.parametrize(
    ("bounds", "reason"),
    [
        (VideoBounds(frames=FRAMES - 1), f"at most {FRAMES - 1} frames"),
        (VideoBounds(pixels=HEIGHT * WIDTH - 1), "pixels"),
        (VideoBounds(memory_bytes=2**27), "needs more"),
        (VideoBounds(silence_s=0.0), "each frame within 0 s"),
    ],
    ids=["frames", "pixels", "memory", "silence"],
)
def test_bounds_hold(h264: bytes, bounds: VideoBounds, reason: str) -> None:
    with pytest.raises(InvalidInput, match=reason):
        decoded(h264, bounds=bounds)


@pytest.mark.fault("S10")
def test_a_decoder_that_takes_too_much_cpu_time_is_ended_and_told_as_that(long_video: bytes) -> None:
    bounds = VideoBounds(cpu_s=1, silence_s=300.0)
    with (
        pytest.raises(InvalidInput, match="within 1 s of CPU time"),
        open_video(long_video, size=(2048, 4096), bounds=bounds) as video,  # larger frames take longer
    ):
        for _ in video:
            pass


@pytest.mark.fault("S10")
def test_a_decoder_that_crashes_is_an_error_of_the_file(long_video: bytes) -> None:
    with open_video(long_video) as video:
        (decoder,) = decoders()
        os.kill(decoder.pid, signal.SIGSEGV)
        with pytest.raises(InvalidInput, match="corrupt"):
            list(video)


@pytest.mark.fault("S10")
def test_a_decoder_that_yields_no_first_frame_is_given_up(h264: bytes) -> None:
    with pytest.raises(InvalidInput, match="each frame within 0 s"):
        decoded(h264, bounds=VideoBounds(first_frame_s=0.0))
    assert not decoders()


def stopped_before_its_first_frame(source: bytes) -> Video:
    """Returns a video whose decoder has stopped, and has written nothing; one that was faster is closed."""
    while True:
        video = open_video(source, bounds=VideoBounds(first_frame_s=600.0))
        os.kill(video._process.pid, signal.SIGSTOP)
        changed = os.waitid(os.P_PID, video._process.pid, os.WSTOPPED | os.WEXITED | os.WNOWAIT)
        assert changed is not None
        if changed.si_code == os.CLD_STOPPED and not select.select([video._pipe], [], [], 0)[0]:
            return video
        video.close()


@pytest.mark.fault("F14")
def test_a_video_waits_for_no_other_videos_first_frame(h264: bytes) -> None:
    stopped = stopped_before_its_first_frame(h264)
    with ThreadPoolExecutor(2) as threads, closing(stopped):
        waiting = threads.submit(lambda: stopped.info)
        try:
            with threads.submit(lambda: open_video(h264).__enter__()).result(60) as video:
                assert video.info.codec == "h264"
        finally:
            stopped.kill()
        assert isinstance(waiting.exception(), InvalidInput)


PARENT = """
import sys, time
from pathlib import Path
from freerein.video import open_video
with open_video(Path(sys.argv[1])) as video:
    print(video._process.pid, flush=True)
    time.sleep(600)
"""


@pytest.mark.fault("F14")
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_a_decoder_ends_with_its_parent_whatever_it_does(
    tmp_path: Path,
    long_video: bytes,
    number: signal.Signals,
    wait_until: Callable[..., float],
    fork_program: Callable[..., Any],
) -> None:
    (tmp_path / "long.mp4").write_bytes(long_video)
    parent = fork_program("tests.code", PARENT, tmp_path / "long.mp4")
    decoder = psutil.Process(int(parent.stdout.readline()))
    decoder.suspend()  # else it would end as it writes to nobody
    parent.process.send_signal(number)
    wait_until(lambda: not decoder.is_running() or decoder.status() == psutil.STATUS_ZOMBIE, 60)


def test_without_a_decoder_it_is_said_how_to_get_one(monkeypatch: pytest.MonkeyPatch, h264: bytes) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _name: None)
    with pytest.raises(Unimplemented) as error:
        open_video(h264)
    assert "freerein[video]" in error.value.hint
