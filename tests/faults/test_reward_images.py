"""Images that no camera takes: rewards and heatmaps stay finite and in range, alone, in a batch and after a restart."""

import base64
import io
import re
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import PIL.Image
import pytest

from freerein.images import encode

pytestmark = pytest.mark.e2e
GOAL = "a red block on top of a yellow block"
StartService = Callable[..., Any]


def opened(service: Any) -> httpx.Client:
    return httpx.Client(base_url=service.until_ready().url, timeout=120, trust_env=False, verify=False)


@pytest.fixture(scope="module")
def reward(start_module_service: StartService) -> Iterator[httpx.Client]:
    """An HTTP client of the service with the shipped models; no image may make it log a fault."""
    service = start_module_service("freerein_reward")
    with opened(service) as client:
        yield client
    assert not re.search(r'"event": "bug"|the model failed|Traceback', service.log.read_text())


def png(pixels: "np.ndarray[Any, Any]") -> bytes:
    return encode(pixels).data


RNG = np.random.default_rng(0)
IMAGES: Mapping[str, bytes] = {
    "black": png(np.zeros((64, 64, 3), np.uint8)),
    "white": png(np.full((64, 64, 3), 255, np.uint8)),
    "one colour": png(np.full((128, 96, 3), (200, 0, 0), np.uint8)),
    "gray": png(RNG.integers(0, 255, (50, 70, 1), np.uint8)),
    "noise": png(RNG.integers(0, 255, (64, 64, 3), np.uint8)),
    "one pixel": png(np.zeros((1, 1, 3), np.uint8)),
    "a row": png(RNG.integers(0, 255, (1, 16_384, 3), np.uint8)),
    "a column": png(RNG.integers(0, 255, (16_384, 1, 3), np.uint8)),
}


def ask(reward: httpx.Client, *images: bytes, **fields: str) -> dict[str, Any]:
    files = [("images", (f"{place}.png", data)) for place, data in enumerate(images)]
    reply = reward.post("/v1/reward", files=files, data={"goal_text": GOAL, **fields})
    assert reply.status_code == 200, reply.text
    answer: dict[str, Any] = reply.json()
    return answer


@pytest.mark.fault("R3")
@pytest.mark.parametrize("name", IMAGES)
def test_a_picture_of_nothing_has_a_reward_in_range(reward: httpx.Client, name: str) -> None:
    raw, binary = ask(reward, IMAGES[name], mode="raw"), ask(reward, IMAGES[name])

    assert -1 <= raw["rewards"][0] <= 1
    assert binary["rewards"][0] in (0.0, 1.0)
    assert binary["similarities"] == raw["similarities"]


@pytest.mark.fault("R3")
@pytest.mark.parametrize("name", IMAGES)
def test_a_picture_of_nothing_has_a_heatmap_of_its_size_in_range(reward: httpx.Client, name: str) -> None:
    data = {"phrases": ["a red block", "a yellow block"]}
    reply = reward.post("/v1/ground", files={"image": ("x.png", IMAGES[name])}, data=data)

    assert reply.status_code == 200, reply.text
    with PIL.Image.open(io.BytesIO(IMAGES[name])) as image:
        width, height = image.size
    for found in reply.json()["groundings"]:
        heatmap = np.frombuffer(base64.b64decode(found["heatmap"]["raw"]), np.float32)
        assert found["heatmap"]["shape"] == [height, width]
        assert ((heatmap >= 0) & (heatmap <= 1)).all()
        assert (0 <= found["x"] <= width, 0 <= found["y"] <= height, 0 <= found["presence"] <= 1) == (True,) * 3


@pytest.mark.fault("R5")
def test_the_reward_is_the_same_alone_together_among_others_and_after_a_restart(
    start_service: StartService, tmp_path: Path
) -> None:
    images = [png(RNG.integers(0, 255, (64, 64, 3), np.uint8)) for _ in range(16)]
    with opened(first := start_service("freerein_reward", tmp_path)) as client:
        alone = [ask(client, image, mode="raw")["rewards"][0] for image in images[:4]]
        together = ask(client, *images, mode="raw")["rewards"]
        with ThreadPoolExecutor(16) as pool:
            merged = list(pool.map(lambda image: ask(client, image, mode="raw"), images))
        assert first.stop() == 0
    with opened(start_service("freerein_reward", tmp_path)) as client:
        again = [ask(client, image, mode="raw")["rewards"][0] for image in images[:4]]

    assert again == alone
    assert max(answer["timing"]["batch_size"] for answer in merged) > 1
    np.testing.assert_allclose(together[:4], alone, atol=1e-5)
    np.testing.assert_allclose([answer["rewards"][0] for answer in merged], together, atol=1e-5)
