"""Gain of many images per call of the reward service.

The model is untrained. Its own call is timed as the service's core makes it, gRPC calls from arrays to arrays, and REST
calls from a prepared body to the parsed reply. All frames are raw.
"""

from collections.abc import Awaitable, Callable
from contextlib import AsyncExitStack
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeAlias

import httpx
import numpy as np
import numpy.typing as npt
import orjson

from benchmarks.report import Ratio, Results
from benchmarks.servers import rest_call, rest_client, run_service
from benchmarks.timing import Effort, Workload, measure_rates, repeat, repeat_function
from benchmarks.untrained import grounding_spec, initialise, publish
from freerein import wire
from freerein.clients import Channel, RewardClient
from freerein.types.reward import RewardRequest
from freerein_reward import model as reward_model
from freerein_reward.core import RewardModel
from freerein_reward.methods.relation_captions.config import RewardConfig
from freerein_reward.methods.relation_captions.losses import network_spec
from freerein_reward.model import DualEncoder

_CAMERA, _GOAL = "front", "a red block on top of a yellow block"
_PHRASES = ("a red block", "a green block", "a yellow block", "a blue block")
_MANY = 32
_TOLERANCE = 1e-5

Similarities: TypeAlias = npt.NDArray[np.float32]
Reward: TypeAlias = Callable[[], Awaitable[Similarities]]


async def measure(effort: Effort) -> Results:
    """Returns the gain in images per second of many images per call."""
    async with AsyncExitStack() as opened:
        folder = Path(opened.enter_context(TemporaryDirectory()))
        model, side_px = _publish(folder)
        no_others = {"FREEREIN_SHIPPED_DIR": str(folder / "none")}
        stack = await opened.enter_async_context(run_service("reward", data_dir=folder, **no_others))
        rest = await opened.enter_async_context(rest_client(stack.urls["reward"]))
        client = await opened.enter_async_context(RewardClient(Channel(stack.addresses["reward"])))
        return await _measure_images(model, side_px, client, rest, effort)


async def _measure_images(
    model: RewardModel, side_px: int, client: RewardClient, rest: httpx.AsyncClient, effort: Effort
) -> Results:
    frames = np.random.default_rng(0).integers(256, size=(_MANY, side_px, side_px, 3), dtype=np.uint8)
    rewards: dict[str, Reward] = {}
    workloads = []
    for size in (1, _MANY):
        request = RewardRequest(_GOAL, {_CAMERA: frames[:size]})
        rewards[f"grpc-{size}"] = _grpc(client, request)
        rewards[f"json-{size}"] = rest_call(rest, "/v1/reward", orjson.dumps(wire.to_json(request)), _similarities)
        workloads += [
            Workload(f"model-{size}", repeat_function(partial(model.embed_images, request.frames)), size, "images"),
            *(Workload(f"{way}-{size}", repeat(rewards[f"{way}-{size}"]), size, "images") for way in ("grpc", "json")),
        ]
    await _check_same_similarities(rewards)
    times = await measure_rates(workloads, effort)
    gains = {where: times.speedup(f"{where}-32", over=f"{where}-1") for where in ("model", "grpc", "json")}
    return Results(
        ratios=(
            Ratio("reward.images32_vs_1.grpc", gains["grpc"], at_least=4.0),
            Ratio("reward.images32_vs_1.model", gains["model"]),
            Ratio("reward.images32_vs_1.json", gains["json"]),
        ),
        rates={"reward.images": times},
    )


async def _check_same_similarities(rewards: dict[str, Reward]) -> None:
    expected = await rewards[f"grpc-{_MANY}"]()
    for name, reward in rewards.items():
        similarities = await reward()
        if not np.allclose(similarities, expected[: len(similarities)], atol=_TOLERANCE):
            raise RuntimeError(f"All calls must return the same similarities; {name} did not.")


def _grpc(client: RewardClient, request: RewardRequest) -> Reward:
    async def call() -> Similarities:
        return (await client.reward(request)).similarities

    return call


def _similarities(reply: Any) -> Similarities:
    return np.array(reply["similarities"], np.float32)


def _publish(data_dir: Path) -> tuple[RewardModel, int]:
    """Publishes an untrained model of a fit's default size; returns it and the side of its images, in pixels."""
    spec = network_spec(grounding_spec(), RewardConfig(cameras=(_CAMERA,), phrases=_PHRASES))
    network = DualEncoder(spec)
    initialise(network)
    publish(network, data_dir, "reward", name="", card={"method": "relation_captions"})
    return reward_model.DualEncoderModel(network), spec.image_size
