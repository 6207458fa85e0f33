"""A trajectory of 10 000 frames over REST and gRPC to the real service, with a model of the real size."""

import asyncio
import base64
from collections.abc import Callable
from typing import Any

import httpx
import numpy as np
import psutil
import pytest
import torch

from freerein.clients import Channel, SegmentationClient
from freerein.learning import weights
from freerein.learning.model_files import save_model
from freerein.model_store import ModelStore
from freerein.types.common import ActionSpec, Camera
from freerein.types.segmentation import SegmentRequest, SegmentResponse
from freerein_segmentation.model import ModelSpec, SegmentationNetwork

T = 10_000
MIB = 2**20
SPEC = ModelSpec(skills=("a", "b", "c"), cameras=(Camera("front", 33, 30, 3),), action=ActionSpec(1, 5, tuple("abcde")))

pytestmark = [pytest.mark.e2e, pytest.mark.fault("S9")]


@pytest.fixture(scope="module")
def service(start_module_service: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory) -> Any:
    data_dir = tmp_path_factory.mktemp("data")
    network = SegmentationNetwork(SPEC)
    weights.initialise(network, generator=torch.Generator().manual_seed(0))
    network.image.fit_normalisation(
        {"front": torch.zeros(1, 33, 30, 3, dtype=torch.uint8)}, generator=torch.Generator()
    )
    save_model(network, data_dir / "unpublished", card={"method": "set_supervised"})
    store = ModelStore(data_dir / "models" / "segmentation")
    store.activate(store.publish("", data_dir / "unpublished"))
    return start_module_service("freerein_segmentation", data_dir, FREEREIN_UNARY_S="600")


def test_ten_thousand_frames_have_equal_labels_over_rest_and_grpc_in_bounded_memory(service: Any) -> None:
    rng = np.random.default_rng(0)
    frames = rng.integers(0, 256, (T, 33, 30, 3), np.uint8)
    actions = rng.integers(0, 5, (T, 1))
    process = psutil.Process(service.process.pid)
    asyncio.run(segment(service.address, frames[:100], actions[:100]))  # what is allocated once
    before = process.memory_info().rss

    over_grpc = asyncio.run(segment(service.address, frames, actions))
    body = {"frames": tensor("UINT8", frames), "actions": tensor("INT64", actions)}
    over_rest = httpx.post(f"{service.url}/v1/segment", json=body, timeout=600, trust_env=False, verify=False).json()

    assert over_grpc.labels.tolist() == over_rest["labels"]
    assert len(over_rest["labels"]) == T
    assert (over_rest["segments"][0]["start"], over_rest["segments"][-1]["end"]) == (0, T)
    assert process.memory_info().rss - before < 400 * MIB  # float frames of the whole would be 119 MB a layer


async def segment(address: str, frames: "np.ndarray[Any, Any]", actions: "np.ndarray[Any, Any]") -> SegmentResponse:
    async with SegmentationClient(Channel(address)) as client:
        return await client.segment(SegmentRequest(frames=frames, actions=actions), timeout_s=600)


def tensor(datatype: str, array: "np.ndarray[Any, Any]") -> dict[str, Any]:
    return {"datatype": datatype, "shape": array.shape, "raw": base64.b64encode(array.tobytes()).decode()}
