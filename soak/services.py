"""The soaked services: as `freerein up` runs them, with the shipped models and a small one for segmentation."""

import asyncio
import os
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, aclosing, asynccontextmanager
from pathlib import Path

import httpx
import torch
from benchmarks.untrained import initialise, publish

from freerein.clients import Channel, ImitationClient, OrchestratorClient, RewardClient, SegmentationClient, SimClient
from freerein.stack import Stack, choose, free_ports, isolated_environ
from freerein.types.common import ActionSpec, Camera
from freerein.types.imitation import GetSpecRequest
from freerein.types.orchestrator import StartRunRequest, WatchRunRequest
from freerein_segmentation.model import ModelSpec, SegmentationNetwork
from soak.questions import Services

_START_S = 120.0
_SPEC = ModelSpec(
    skills=("a", "b", "c"),
    cameras=(Camera("front", 33, 30, 3),),
    action=ActionSpec(1, 5, tuple("abcde")),
    context=3,  # streams need a bounded one
)
_SETTINGS = {
    "OMP_NUM_THREADS": "1",
    "FREEREIN_SIM_WORKERS": "2",
    "FREEREIN_GOAL_CACHE_BYTES": "20000",  # fewer than the texts of the load: a cache that fills up is no leak
}
_LIMITS = httpx.Limits(
    keepalive_expiry=1.0
)  # shorter than the services', or both may use and close a connection at once
_RUN = {"task": "grid", "dataset": "soaked", "behaviour": "random", "count": 3}


@asynccontextmanager
async def start(data_dir: Path) -> AsyncIterator[tuple[Stack, Services]]:
    """Runs the services while the block lasts."""
    publish_segmentation_model(data_dir)
    modules = choose(())
    environ = {**isolated_environ(os.environ), **_SETTINGS}
    async with AsyncExitStack() as opened:
        stack = await opened.enter_async_context(
            Stack(modules, data_dir=data_dir, environ=environ, ports=free_ports(modules))
        )
        await stack.ready(timeout_s=_START_S)
        channels = {name: Channel(address) for name, address in stack.addresses.items()}
        sim = await opened.enter_async_context(SimClient(channels["sim"]))
        segmentation = await opened.enter_async_context(SegmentationClient(channels["segmentation"]))
        imitation = await opened.enter_async_context(ImitationClient(channels["imitation"]))
        reward = await opened.enter_async_context(RewardClient(channels["reward"]))
        orchestrator = await opened.enter_async_context(OrchestratorClient(channels["orchestrator"]))
        rest = await opened.enter_async_context(httpx.AsyncClient(trust_env=False, timeout=30, limits=_LIMITS))
        spec = await imitation.get_spec(GetSpecRequest())
        run_id = await run_once(orchestrator)
        yield (
            stack,
            Services(
                sim, segmentation, imitation, reward, orchestrator, rest, stack.addresses, stack.urls, spec, run_id
            ),
        )


def publish_segmentation_model(data_dir: Path) -> None:
    """Publishes and activates a network with random weights, which answers sooner than those that ship."""
    network = SegmentationNetwork(_SPEC)
    initialise(network)
    camera = _SPEC.cameras[0]
    black = torch.zeros(1, camera.height, camera.width, camera.channels, dtype=torch.uint8)
    network.image.fit_normalisation({camera.name: black}, generator=torch.Generator())
    publish(network, data_dir, "segmentation", name="", card={"method": "set_supervised"})


async def run_once(orchestrator: OrchestratorClient) -> str:
    """Returns a run that has succeeded."""
    run = (await orchestrator.start_run(StartRunRequest("collect", _RUN, "soaked"))).run
    async with asyncio.timeout(_START_S), aclosing(orchestrator.watch_run(WatchRunRequest(run.id))) as events:
        async for event in events:
            run = event.run
    if run.state != "succeeded":
        raise RuntimeError(f"The run ended as {run.state}: {run.error}")
    return run.id
