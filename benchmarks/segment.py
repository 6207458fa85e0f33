"""Latency of labelling a trajectory through each interface of the segmentation service, beside the bare model.

The model is untrained. A REST call is timed from a prepared body, as frames lie on disk or come from a camera, to the
parsed reply, a gRPC call from arrays to arrays. JSON is sent with PNG images, as in multipart, and with one tensor of
raw frames, as over gRPC.
"""

import json
from collections.abc import Awaitable, Callable
from contextlib import AsyncExitStack, closing
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeAlias

import httpx
import numpy as np
import numpy.typing as npt
import torch

from benchmarks.report import Ratio, Results
from benchmarks.servers import rest_call, rest_client, run_service
from benchmarks.timing import Effort, Workload, measure_rates, repeat
from benchmarks.untrained import initialise, publish
from freerein import images, wire
from freerein.clients import Channel, SegmentationClient
from freerein.types.common import ModelRef
from freerein.types.segmentation import SegmentRequest
from freerein_segmentation.model import ModelSpec, SegmentationModel, SegmentationNetwork, load
from freerein_sim.worlds.random_policy import SmoothRandomPolicy
from freerein_sim.worlds.tasks import tasks

_PATH = "/v1/segment"

Labels: TypeAlias = npt.NDArray[np.int64]
Segment: TypeAlias = Callable[[], Awaitable[Labels]]


@dataclass(frozen=True, eq=False)
class _Case:
    """A trajectory to label: uint8 (T, H, W, C) and float32 (T, A) or int64 (T, 1); `task` also names its model."""

    name: str
    task: str
    frames: npt.NDArray[np.uint8]
    actions: npt.NDArray[Any]


async def measure(effort: Effort) -> Results:
    """Returns the latency of each interface relative to the model call, for each trajectory."""
    cases = (_random_trajectory("T100-64px", "blocks", 100), _random_trajectory("T1000-33x30px", "grid", 1000))
    results = Results()
    with TemporaryDirectory() as folder:
        models = {case.name: _publish(case, Path(folder)) for case in cases}
        async with run_service("segmentation", data_dir=Path(folder)) as stack:
            address, url = stack.addresses["segmentation"], stack.urls["segmentation"]
            for case in cases:
                results += await _measure_case(case, models[case.name], address, url, effort)
    return results


async def _measure_case(case: _Case, model: SegmentationModel, address: str, url: str, effort: Effort) -> Results:
    async with AsyncExitStack() as opened:
        rest = await opened.enter_async_context(rest_client(url))
        client = await opened.enter_async_context(SegmentationClient(Channel(address)))
        request = SegmentRequest(ModelRef(case.task), case.frames, actions=case.actions)
        png_request = replace(request, frames=None, images=tuple(map(images.encode, case.frames)))

        async def bare() -> Labels:
            labels: Labels = model.predict(case.frames, case.actions).probabilities.argmax(axis=1)
            return labels

        async def grpc() -> Labels:
            return (await client.segment(request)).labels

        interfaces: dict[str, Segment] = {
            "grpc": grpc,
            "json-frames": _rest(rest, httpx.Request("POST", _PATH, json=wire.to_json(request))),
            "json-images": _rest(rest, httpx.Request("POST", _PATH, json=wire.to_json(png_request))),
            "multipart": _rest(rest, _multipart(png_request)),
        }
        expected = await bare()
        workloads = [_workload(name, segment, expected) for name, segment in {"torch": bare, **interfaces}.items()]
        times = await measure_rates(workloads, effort)
    ratios = (Ratio(f"segment.{each}_vs_torch.{case.name}", times.speedup("torch", over=each)) for each in interfaces)
    return Results(tuple(ratios), {f"segment.{case.name}": times})


def _workload(name: str, segment: Segment, expected: Labels) -> Workload:
    async def call() -> None:
        if not np.array_equal(await segment(), expected):
            raise RuntimeError(f"All interfaces must return the model's labels; {name} did not.")

    return Workload(name, repeat(call), 1, "calls")


def _random_trajectory(name: str, task_name: str, timesteps: int) -> _Case:
    """Returns a trajectory of the random behaviour, longer than an episode if need be."""
    task, rng = tasks()[task_name], np.random.default_rng(0)
    behaviour, camera = SmoothRandomPolicy(task.spec.action, rng), task.spec.cameras[0]
    frames, actions = [], []
    with closing(task.make()) as world:
        world.reset(rng)
        for _ in range(timesteps):
            frames.append(world.render(camera.name, height=camera.height, width=camera.width))
            actions.append(behaviour.act().action)
            world.step(actions[-1])
    return _Case(name, task_name, np.stack(frames), np.stack(actions))


def _publish(case: _Case, data_dir: Path) -> SegmentationModel:
    """Publishes an untrained model for a case; returns it."""
    spec = tasks()[case.task].spec
    camera = spec.cameras[0]
    network = SegmentationNetwork(ModelSpec(skills=spec.skills, cameras=(camera,), action=spec.action))
    initialise(network)
    frames = {camera.name: torch.from_numpy(case.frames)}
    network.image.fit_normalisation(frames, generator=torch.Generator())
    ref = publish(network, data_dir, "segmentation", name=case.task, card={"method": "set_supervised"})
    return load(data_dir / "models" / "segmentation" / ref.name / ref.version, "cpu")


def _rest(client: httpx.AsyncClient, request: httpx.Request) -> Segment:
    media_type = request.headers["content-type"]
    return rest_call(client, _PATH, request.read(), lambda reply: np.array(reply["labels"]), media_type=media_type)


def _multipart(request: SegmentRequest) -> httpx.Request:
    fields = {"model.name": request.model.name, "actions": json.dumps(wire.to_json(request)["actions"])}
    files = [("images", (f"{t}.png", image.data, "image/png")) for t, image in enumerate(request.images)]
    return httpx.Request("POST", _PATH, data=fields, files=files)
