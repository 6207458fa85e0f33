"""Image files and trajectories that mean harm: refused by their headers, in our words, while others are served."""

import base64
import io
import json
import statistics
import struct
import threading
import time
import zlib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import PIL.Image
import pytest
from tests.faults.growth import Growth

pytestmark = pytest.mark.e2e
SEGMENT = "/v1/segment"
MiB = 2**20


@pytest.fixture(scope="module")
def audit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("audit") / "touched.txt"


@pytest.fixture(scope="module")
def faulty(start_faulty: Callable[..., Any], audit: Path) -> Any:
    return start_faulty(FAULTY_AUDIT=str(audit))


def save(image: PIL.Image.Image, file_format: str, **options: Any) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, file_format, **options)
    return buffer.getvalue()


def png(
    width: int,
    height: int,
    *,
    depth: int = 8,
    colour: int = 0,
    raw: bytes = b"\0",
    before: bytes = b"",
    extra: bytes = b"",
) -> bytes:
    """Returns a PNG by hand, whose header may lie, with chunks before and after its header."""
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0))
    data = chunk(b"IDAT", zlib.compress(raw)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + before + header + extra + data


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


SMALL = PIL.Image.fromarray(np.arange(48, dtype=np.uint8).reshape(4, 4, 3))


def send(faulty: Any, *files: bytes) -> httpx.Response:
    return faulty.http.post(SEGMENT, files=[("images", (f"{t}.png", data)) for t, data in enumerate(files)])


def send_json(faulty: Any, *images: dict[str, Any]) -> httpx.Response:
    return faulty.http.post(SEGMENT, json={"images": images})


def image(encoding: str, data: bytes, **size: int) -> dict[str, Any]:
    return {"encoding": encoding, "data": base64.b64encode(data).decode(), **size}


def bombs() -> dict[str, tuple[bytes, int]]:
    black = PIL.Image.new("L", (8_000, 8_000))
    return {
        "a png of 64 million pixels": (save(black, "PNG", compress_level=1), 422),
        "a png that lies": (png(20_000, 20_000), 422),
        "a png of 2^62 pixels": (png(2**31 - 1, 2**31 - 1), 422),
        "jpeg": (jpeg(8_000), 422),
        "webp": (save(PIL.Image.new("RGB", (4_100, 4_100)), "WEBP", method=0, quality=1), 422),
        "gif": (save(PIL.Image.new("L", (4_100, 4_100)), "GIF"), 415),
        "tiff": (save(PIL.Image.new("L", (4_100, 4_100)), "TIFF", compression="tiff_lzw"), 415),
        "text that unpacks": (png(4, 4, colour=2, raw=bytes(52), extra=text_bomb()), 200),
        "colour profile that unpacks": (png(4, 4, colour=2, raw=bytes(52), extra=profile_bomb(100 * MiB, 1)), 200),
    }


def text_bomb() -> bytes:
    return chunk(b"zTXt", b"a\0\0" + zlib.compress(bytes(100 * MiB), 1))


def profile_bomb(size: int, level: int = 6) -> bytes:
    return chunk(b"iCCP", b"a\0\0" + zlib.compress(bytes(size), level))


@pytest.mark.fault("S1")
def test_a_bomb_is_read_by_its_header_and_takes_no_memory(faulty: Any, refusal: Any) -> None:
    assert send(faulty, save(SMALL, "PNG")).status_code == 200
    for name, (data, status) in bombs().items():
        with Growth(faulty.process) as growth:
            for reply in (send(faulty, data), send(faulty, save(SMALL, "PNG"), data)):
                assert reply.status_code == 200 or refusal(reply, status)["field"].startswith("images"), name
        assert growth.most < 64 * MiB, name


def segment(marker: int, data: bytes = b"") -> bytes:
    """Returns a segment of a JPEG."""
    return bytes([0xFF, marker]) + struct.pack(">H", len(data) + 2) + data


def jpeg(side: int, *, scans: int = 0, extra: bytes = b"") -> bytes:
    """Returns a black progressive JPEG by hand, whose further scans say in a few bytes that no pixel changes."""
    header = struct.pack(">BHHB", 8, side, side, 1) + b"\1\x11\0"
    codes = segment(0xC4, b"\0\1" + bytes(16)) + segment(0xC4, b"\x10\1" + bytes(15) + b"\xe0")  # 0, and a long run
    first = segment(0xDA, b"\1\1\0\0\0\0") + bytes((side // 8) ** 2 // 8 + 1)
    refine = segment(0xDA, b"\1\1\0\1\x3f\x10") + b"\x7f\xff\0" * 8
    return (
        b"\xff\xd8"
        + extra
        + segment(0xDB, bytes(1) + b"\1" * 64)
        + segment(0xC2, header)
        + codes
        + first
        + (refine * scans + b"\xff\xd9")
    )


def webp_of_chunks(count: int) -> bytes:
    extended = b"VP8X" + struct.pack("<I", 10) + bytes(4) + b"\3\0\0" * 2
    body = b"WEBP" + extended + save(SMALL, "WEBP")[12:] + (b"free" + bytes(4)) * count
    return b"RIFF" + struct.pack("<I", len(body)) + body


COSTLY: dict[str, Callable[[], bytes]] = {  # each took 0.7 to 8 s, or 200 to 600 MiB, when it was decoded
    "scans": lambda: jpeg(4_000, scans=1_000),
    "one column": lambda: png(1, 16_000_000, raw=bytes(32_000_000)),
    "empty chunks": lambda: png(4, 4, colour=2, raw=bytes(52), extra=chunk(b"teSt", b"") * 1_000_000),
    "empty comments": lambda: jpeg(8, extra=segment(0xFE) * 1_000_000),
    "metadata in parts": lambda: jpeg(8, extra=segment(0xE1, b"Exif\0\0" + bytes(65_000)) * 400),
    "bytes between segments": lambda: jpeg(8, extra=segment(0xFE) + bytes(10 * MiB)),
    "webp of chunks": lambda: webp_of_chunks(5_000_000),
}


@pytest.mark.fault("F3")
@pytest.mark.fault("F6")
@pytest.mark.parametrize("name", COSTLY)
def test_a_file_that_is_costly_to_decode_is_refused_by_its_structure(faulty: Any, refusal: Any, name: str) -> None:
    data = COSTLY[name]()
    before = faulty.cpu_s()
    refusal(send(faulty, bytes(len(data))), 415)
    received_s = faulty.cpu_s() - before  # as many bytes
    before = faulty.cpu_s()
    with Growth(faulty.process) as growth:
        assert refusal(send(faulty, data), 422)["field"] == "images.0"
    assert faulty.cpu_s() - before < 0.5 + 3 * received_s
    assert growth.most < 64 * MiB + 4 * len(data)  # two copies, and two of the file before, if not yet freed


@pytest.mark.fault("F6")
def test_metadata_is_not_unpacked(faulty: Any) -> None:
    data = png(4, 4, colour=2, raw=bytes(52), extra=profile_bomb(MiB - 100) * 2_000)  # 4 s when it was unpacked

    before = faulty.cpu_s()
    assert send(faulty, data).status_code == 200
    assert faulty.cpu_s() - before < 0.5


@pytest.mark.fault("F3")
def test_an_image_of_another_size_than_the_models_is_not_decoded(faulty: Any, refusal: Any) -> None:
    large = jpeg(4_000, scans=31)

    before = faulty.cpu_s()
    for files in ((large,), (save(SMALL, "PNG"), large)):
        assert "4 x 4; got 4000 x 4000" in refusal(send(faulty, *files), 422)["detail"]
    assert faulty.cpu_s() - before < 0.2  # 4 s when both were decoded


def elsewhere(faulty: Any, audit: Path, before: int) -> list[str]:
    """Returns the files outside of its data that the service opened, and the addresses that it connected to, since."""
    touched = audit.read_bytes()[before:].decode(errors="replace").splitlines()
    return [line for line in touched if str(faulty.service.data_dir) not in line]


OTHERS = {
    name: save(PIL.Image.new("RGB", (8, 8)), name) for name in ("GIF", "TIFF", "PPM", "BMP", "ICO", "PDF", "EPS", "TGA")
} | {
    "SVG": b"<svg xmlns='http://www.w3.org/2000/svg'><image href='file:///etc/passwd'/></svg>",
    "PSD": b"8BPS\0\1" + bytes(40),
    "empty": b"",
    "text": b"GET / HTTP/1.1\r\n\r\n",
}


@pytest.mark.fault("S2")
@pytest.mark.parametrize("name", OTHERS)
def test_a_format_that_is_not_served_is_not_opened(faulty: Any, refusal: Any, audit: Path, name: str) -> None:
    before = len(audit.read_bytes())
    refusal(send(faulty, OTHERS[name]), 415)
    for claimed in ("png", "jpeg", "webp"):
        refusal(send_json(faulty, image(claimed, OTHERS[name])), 415)
    assert elsewhere(faulty, audit, before) == []


@pytest.mark.fault("S5")
def test_the_limit_is_on_what_is_sent_and_not_on_what_it_decodes_to(faulty: Any, refusal: Any) -> None:
    body = b'{"images": [{"encoding": "png", "data": "%s"}]}' % (b"A" * (64 * MiB))
    headers = {"content-type": "application/json"}
    with Growth(faulty.process) as growth:
        refusal(faulty.http.post(SEGMENT, content=body, headers=headers), 413)
    assert growth.most < 16 * MiB


@pytest.mark.fault("S6")
@pytest.mark.fault("G11")
@pytest.mark.parametrize("url", ["http://127.0.0.1:{port}/healthz", "file:///etc/passwd", "gopher://127.0.0.1/"])
def test_no_url_is_ever_followed(faulty: Any, refusal: Any, audit: Path, url: str) -> None:
    address = url.format(port=faulty.service.http_port)
    before = len(audit.read_bytes())
    refusal(send_json(faulty, {"encoding": "png", "url": address}), 422)
    refusal(send_json(faulty, {"encoding": "png", "data": address}), 422)
    refusal(faulty.http.post(SEGMENT, json={"images": [address]}), 422)
    refusal(faulty.http.post(SEGMENT, json={"images": address}), 422)
    refusal(send(faulty, address.encode()), 415)
    assert elsewhere(faulty, audit, before) == []


@pytest.mark.fault("S7")
def test_too_many_images_are_refused_before_they_are_decoded(faulty: Any, refusal: Any) -> None:
    many = json.dumps({"images": [image("png", save(PIL.Image.new("1", (100, 100)), "PNG"))] * 10_000})
    with Growth(faulty.process) as growth:
        reply = faulty.http.post(SEGMENT, content=many, headers={"content-type": "application/json"})
        assert "64000000 pixels" in refusal(reply, 422)["detail"]
    assert growth.most < 64 * MiB
    most = json.dumps({"images": [image("raw_gray8", b"\0", height=1, width=1)] * 20_001})
    reply = faulty.http.post(SEGMENT, content=most, headers={"content-type": "application/json"})
    assert "20001" in refusal(reply, 422)["detail"]


@pytest.mark.fault("S8")
@pytest.mark.fault("G10")
def test_health_is_told_at_once_while_images_are_decoded(
    start_faulty: Callable[..., Any], least_of_many: Any, fuzz: bool
) -> None:
    faulty = start_faulty(FAULTY_SIDE="2000")
    noise = np.random.default_rng(0).integers(0, 255, (2_000, 2_000), np.uint8)
    files = {"images": ("0.png", save(PIL.Image.fromarray(noise), "PNG"))}
    form = httpx.Request("POST", faulty.service.url + SEGMENT, files=files, headers={"connection": "close"})
    lines = [f"{name}: {value}" for name, value in form.headers.items()]
    request = "\r\n".join([f"POST {SEGMENT} HTTP/1.1", *lines, "", ""]).encode() + form.read()

    def share_of_a_decode() -> float:
        """Returns how long half of the health checks take at most, in mean times of a decode."""
        stop = threading.Event()
        with ThreadPoolExecutor(1) as health, ThreadPoolExecutor(10) as pool:
            latencies = health.submit(latencies_until, faulty, stop)
            begun = time.perf_counter()
            decoded = list(pool.map(lambda _: faulty.raw(request), range(50 if fuzz else 12)))
            decode_s = (time.perf_counter() - begun) / len(decoded)
            stop.set()
        assert {reply.split()[1] for reply in decoded} == {b"422"}  # decoded, and gray, which the model is not
        return statistics.median(latencies.result()) / decode_s

    assert least_of_many(share_of_a_decode, below=1) < 1


def latencies_until(faulty: Any, stop: threading.Event) -> list[float]:
    seconds = []
    with httpx.Client(base_url=faulty.service.url, timeout=60, trust_env=False) as client:
        while not stop.wait(0.01):
            seconds.append(latency(client))
    return seconds


def latency(client: httpx.Client) -> float:
    begun = time.perf_counter()
    assert client.get("/healthz").status_code == 200
    return time.perf_counter() - begun


@pytest.mark.fault("S9")
def test_frames_of_mixed_sizes_are_refused_with_both(faulty: Any, refusal: Any) -> None:
    detail = refusal(send(faulty, save(SMALL, "PNG"), save(SMALL.resize((5, 4)), "PNG")), 422)["detail"]
    assert "4 x 4; got 4 x 5" in detail
    detail = refusal(send(faulty, save(SMALL, "PNG"), save(SMALL.convert("L"), "PNG")), 422)["detail"]
    assert "(4, 4, 3)" in detail
    assert "(4, 4, 1)" in detail


@pytest.mark.fault("S9")
def test_a_trajectory_that_is_too_long_is_too_large_and_the_longest_is_answered(faulty: Any, refusal: Any) -> None:
    with Growth(faulty.process) as growth:
        problem = refusal(faulty.segment(*bytes(100_000)), 413)
    assert "20000" in problem["detail"]
    assert "100000" in problem["detail"]
    assert growth.most < 64 * MiB
    brightness = [t // 100 for t in range(20_000)]
    reply = faulty.segment(*(value % 256 for value in brightness))
    assert reply.json()["labels"] == [value % 2 for value in brightness]


@pytest.mark.fault("S9")
@pytest.mark.fault("R6")
def test_an_unknown_model_is_told_from_one_that_was_never_fitted(faulty: Any, refusal: Any) -> None:
    request = faulty.trajectory()
    refusal(faulty.http.post(SEGMENT, json={**request, "model": {"version": "0" * 12}}), 404)
    problem = refusal(faulty.http.post(SEGMENT, json={**request, "model": {"name": "other"}}), 409)
    assert "freerein fit segmentation" in problem["hint"]


@pytest.mark.fault("S9")
@pytest.mark.parametrize(("smoothing", "min_segment"), [(5e-324, 0), (1e-300, 1), (0.01, 1000), (100.0, 0)])
def test_any_smoothing_and_merging_within_bounds_is_answered(faulty: Any, smoothing: float, min_segment: int) -> None:
    request = {**faulty.trajectory([0, 1, 1, 0, 1]), "smoothing": smoothing, "min_segment": min_segment}
    reply = faulty.http.post(SEGMENT, json=request)
    assert len(reply.json()["labels"]) == 5
