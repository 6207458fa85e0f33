"""What the reward service gains by remembering goal texts and by taking many images at once.

The model is untrained, which changes no time. Its own call is timed as the service's core makes it, and the service's
calls from arrays, or for JSON from a body that is ready, to the parsed reply. Frames are raw everywhere.
"""

from collections.abc import Awaitable, Callable
from contextlib import AsyncExitStack
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeAlias

import httpx
import numpy as np
import numpy.typing as npt
import orjson
import torch

from benchmarks.latencies import Caller, time_calls
from benchmarks.report import Bar, Findings, Ratio
from benchmarks.rounds import Contestant, Effort, race
from benchmarks.services import running
from freerein import wire
from freerein.clients import Channel, RewardClient
from freerein.learning import weights
from freerein.learning.model_files import save_model
from freerein.serving.model_store import ModelStore
from freerein.types.common import ModelRef
from freerein.types.reward import EmbedGoalRequest, RewardRequest
from freerein_reward import model
from freerein_reward.core import GoalCache, Inference, RewardModel
from freerein_reward.core.inference import ScoreItem
from freerein_reward.model import REWARD, DualEncoder, DualEncoderSpec
from freerein_reward.training import GroundingConfig, RewardConfig, network_spec, synthetic_objects

_CAMERA, _GOAL = "front", "a red block on top of a yellow block"
_MANY = 32
_TIMEOUT_S = 60.0
_CACHE_BYTES = 16 * 2**20
_PATH = "/v1/reward"
_CLOSE = 1e-5

Frames: TypeAlias = npt.NDArray[np.uint8]
Similarities: TypeAlias = npt.NDArray[np.float32]
Reward: TypeAlias = Callable[[], Awaitable[Similarities]]


async def measure(effort: Effort) -> Findings:
    """Returns what a text costs that was asked for before, and how many more images per second a batch gives."""
    async with AsyncExitStack() as opened:
        folder = Path(opened.enter_context(TemporaryDirectory()))
        ref, reward_model, side_px = _publish(folder)
        bare = {"FREEREIN_SHIPPED_DIR": str(folder / "none")}
        stack = await opened.enter_async_context(running("reward", data_dir=folder, **bare))
        url = stack.urls["reward"]
        rest = await opened.enter_async_context(httpx.AsyncClient(base_url=url, timeout=_TIMEOUT_S, trust_env=False))
        client = await opened.enter_async_context(RewardClient(Channel(stack.addresses["reward"])))
        goals = await _measure_goals(ref, reward_model, client, effort)
        return goals + await _measure_images(reward_model, side_px, client, rest, effort)


async def _measure_goals(ref: ModelRef, reward_model: RewardModel, client: RewardClient, effort: Effort) -> Findings:
    inference, numbers = Inference(GoalCache(_CACHE_BYTES)), count()

    async def infer(text: str) -> None:
        inference.run([ScoreItem(ref, reward_model, (text,))])

    async def call(text: str) -> None:
        await client.embed_goal(EmbedGoalRequest(text))

    def known(embed: Callable[[str], Awaitable[None]]) -> Callable[[], Awaitable[None]]:
        return lambda: embed(_GOAL)

    def new(embed: Callable[[str], Awaitable[None]]) -> Callable[[], Awaitable[None]]:
        return lambda: embed(f"{_GOAL} {next(numbers)}")

    callers = [
        Caller("model-cached", known(infer)),
        Caller("model-uncached", new(infer)),
        Caller("grpc-cached", known(call)),
        Caller("grpc-uncached", new(call)),
    ]
    times = await time_calls(callers, effort)
    ratios = {where: times.ratio(f"{where}-cached", over=f"{where}-uncached", share=0.5) for where in ("model", "grpc")}
    return Findings(
        ratios=(
            Ratio("reward.goal_cached_vs_uncached.grpc", ratios["grpc"], Bar("at most", 0.5)),
            Ratio("reward.goal_cached_vs_uncached.model", ratios["model"]),
        ),
        latencies={"reward.embed-goal": times},
    )


async def _measure_images(
    reward_model: RewardModel, side_px: int, client: RewardClient, rest: httpx.AsyncClient, effort: Effort
) -> Findings:
    frames = np.random.default_rng(0).integers(256, size=(_MANY, side_px, side_px, 3), dtype=np.uint8)
    one, many = (RewardRequest(_GOAL, {_CAMERA: some}) for some in (frames[:1], frames))
    doors = {
        "grpc-1": _caller(client, one),
        "grpc-32": _caller(client, many),
        "json-1": _poster(rest, one),
        "json-32": _poster(rest, many),
    }
    await _check_same_rewards(doors)
    contestants = [
        _embedding("model-1", reward_model, frames[:1]),
        _embedding("model-32", reward_model, frames),
        *(_rewarding(name, reward) for name, reward in doors.items()),
    ]
    times = await race(contestants, effort)
    gains = {where: times.speedup(f"{where}-32", over=f"{where}-1") for where in ("model", "grpc", "json")}
    return Findings(
        ratios=(
            Ratio("reward.images32_vs_1.grpc", gains["grpc"], Bar("at least", 4.0)),
            Ratio("reward.images32_vs_1.model", gains["model"]),
            Ratio("reward.images32_vs_1.json", gains["json"]),
        ),
        raw={"reward.images": times},
    )


async def _check_same_rewards(doors: dict[str, Reward]) -> None:
    expected = await doors["grpc-32"]()
    for name, reward in doors.items():
        similarities = await reward()
        if not np.allclose(similarities, expected[: len(similarities)], atol=_CLOSE):
            raise RuntimeError(f"All doors must answer alike, one frame at a time or many; {name} did not.")


def _embedding(name: str, reward_model: RewardModel, frames: Frames) -> Contestant:
    async def run(times: int) -> None:
        for _ in range(times):
            reward_model.embed_images({_CAMERA: frames})

    return Contestant(name, run, len(frames), "images")


def _rewarding(name: str, reward: Reward) -> Contestant:
    async def run(times: int) -> None:
        for _ in range(times):
            await reward()

    return Contestant(name, run, int(name.rpartition("-")[2]), "images")


def _caller(client: RewardClient, request: RewardRequest) -> Reward:
    async def reward() -> Similarities:
        return (await client.reward(request)).similarities

    return reward


def _poster(client: httpx.AsyncClient, request: RewardRequest) -> Reward:
    """Returns what sends a REST call whose body, in JSON with a tensor of raw frames, is ready."""
    body, headers = orjson.dumps(wire.to_json(request)), {"content-type": "application/json"}

    async def reward() -> Similarities:
        response = await client.post(_PATH, content=body, headers=headers)
        response.raise_for_status()
        return np.array(orjson.loads(response.content)["similarities"], np.float32)

    return reward


def _publish(data_dir: Path) -> tuple[ModelRef, RewardModel, int]:
    """Puts a model of the size that fits make into the service's store, active; returns it, and its images' side."""
    tower = GroundingConfig()
    grounding = DualEncoderSpec(
        cameras=("",),
        vocabulary=synthetic_objects.VOCABULARY,
        image_size=synthetic_objects.IMAGE_SIZE,
        width=tower.width,
        depth=tower.depth,
    )
    spec = network_spec(grounding, RewardConfig(cameras=(_CAMERA,)))
    network = DualEncoder(spec)
    weights.initialise(network, generator=torch.Generator().manual_seed(0))
    folder = data_dir / "untrained"
    folder.mkdir()
    save_model(network, folder, card={"kind": REWARD})
    store = ModelStore(data_dir / "models" / "reward")
    ref = store.publish("", folder)
    store.activate(ref)
    return ref, model.DualEncoderModel(network), spec.image_size
