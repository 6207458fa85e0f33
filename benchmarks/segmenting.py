"""How long it takes to label a trajectory through each door of the segmentation service, beside the bare model.

The model is untrained, which changes no time. A REST call is timed from a body that is ready to be sent, as frames lie
on disk or come from a camera, to the parsed reply; a gRPC call from arrays to arrays. JSON comes in two forms: with PNG
images, as multipart has them, and with one tensor of raw frames, as gRPC has them.
"""

import base64
from collections.abc import Awaitable, Callable
from contextlib import AsyncExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeAlias

import httpx
import numpy as np
import numpy.typing as npt
import orjson
import torch

from benchmarks.report import Findings, Ratio
from benchmarks.rounds import Contestant, Effort, race
from benchmarks.services import running
from freerein import images, tensors
from freerein.clients import Channel, SegmentationClient
from freerein.learning import weights
from freerein.learning.model_files import save_model
from freerein.serving.model_store import ModelStore
from freerein.types.common import ModelRef
from freerein.types.segmentation import SegmentRequest
from freerein_segmentation.model import ModelSpec, SegmentationModel, SegmentationNetwork, load
from freerein_sim.worlds.random_policy import SmoothRandomPolicy
from freerein_sim.worlds.tasks import tasks

_TIMEOUT_S = 60.0
_PATH = "/v1/segment"

Labels: TypeAlias = npt.NDArray[np.int64]
Segment: TypeAlias = Callable[[], Awaitable[Labels]]


@dataclass(frozen=True, eq=False)
class _Case:
    """A trajectory to label, and a model for it.

    Attributes:
        name: As it is published.
        task: Whose world it shows; the model's name, too.
        frames: uint8 (T, H, W, C).
        actions: float32 (T, A) or int64 (T, 1).
    """

    name: str
    task: str
    frames: npt.NDArray[np.uint8]
    actions: npt.NDArray[Any]


async def measure(effort: Effort) -> Findings:
    """Returns how many times as long as in process a call takes, for each door and trajectory."""
    cases = (_wander("T100-64px", "blocks", 100), _wander("T1000-33x30px", "grid", 1000))
    found = Findings()
    with TemporaryDirectory() as folder:
        models = {case.name: _publish(case, Path(folder)) for case in cases}
        async with running("segmentation", data_dir=Path(folder)) as stack:
            address, url = stack.addresses["segmentation"], stack.urls["segmentation"]
            for case in cases:
                found += await _measure_case(case, models[case.name], address, url, effort)
    return found


async def _measure_case(case: _Case, model: SegmentationModel, address: str, url: str, effort: Effort) -> Findings:
    async with AsyncExitStack() as opened:
        rest = await opened.enter_async_context(httpx.AsyncClient(base_url=url, timeout=_TIMEOUT_S, trust_env=False))
        client = await opened.enter_async_context(SegmentationClient(Channel(address)))
        request = SegmentRequest(ModelRef(case.task), case.frames, actions=case.actions)

        async def bare() -> Labels:
            labels: Labels = model.probabilities(case.frames, case.actions).argmax(axis=1)
            return labels

        async def grpc() -> Labels:
            return (await client.segment(request)).labels

        doors: dict[str, Segment] = {
            "grpc": grpc,
            "json-frames": _poster(rest, _json_frames(case)),
            "json-images": _poster(rest, _json_images(case)),
            "multipart": _poster(rest, _multipart(case)),
        }
        expected = await bare()
        contestants = [_contestant(name, segment, expected) for name, segment in {"torch": bare, **doors}.items()]
        times = await race(contestants, effort)
    ratios = (Ratio(f"segment.{door}_vs_torch.{case.name}", times.speedup("torch", over=door)) for door in doors)
    return Findings(tuple(ratios), {f"segment.{case.name}": times})


def _contestant(name: str, segment: Segment, expected: Labels) -> Contestant:
    async def run(count: int) -> None:
        for _ in range(count):
            if not np.array_equal(await segment(), expected):
                raise RuntimeError(f"All doors must answer as the model does; {name} did not.")

    return Contestant(name, run, 1, "calls")


def _wander(name: str, task_name: str, timesteps: int) -> _Case:
    """Returns what somebody saw who moved at random; it goes on where an episode would end."""
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
    """Puts an untrained model for a case into the service's store, active; returns it."""
    spec, (_, height, width, channels) = tasks()[case.task].spec, case.frames.shape
    network = SegmentationNetwork(
        ModelSpec(
            skills=spec.skills,
            camera=spec.cameras[0].name,
            height=height,
            width=width,
            channels=channels,
            action_size=spec.action.size,
            action_choices=spec.action.choices,
        )
    )
    weights.initialise(network, generator=torch.Generator().manual_seed(0))
    network.image.fit_normalisation(torch.from_numpy(case.frames))
    folder = data_dir / f"{case.task}.new"
    folder.mkdir()
    save_model(network, folder, card={})
    store = ModelStore(data_dir / "models" / "segmentation")
    ref = store.publish(case.task, folder)
    store.activate(ref)
    return load(store.folder(ref), "cpu")


def _poster(client: httpx.AsyncClient, request: httpx.Request) -> Segment:
    """Returns what sends a REST call whose body is ready."""
    body, headers = request.read(), {"content-type": request.headers["content-type"]}

    async def segment() -> Labels:
        response = await client.post(_PATH, content=body, headers=headers)
        response.raise_for_status()
        return np.array(orjson.loads(response.content)["labels"])

    return segment


def _json_frames(case: _Case) -> httpx.Request:
    return _json(case, {"frames": _tensor(case.frames)})


def _json_images(case: _Case) -> httpx.Request:
    pngs = (base64.b64encode(png).decode() for png in _pngs(case))
    return _json(case, {"images": [{"encoding": "png", "data": png} for png in pngs]})


def _json(case: _Case, seen: dict[str, Any]) -> httpx.Request:
    body = {"model": {"name": case.task}, "actions": _tensor(case.actions), **seen}
    return httpx.Request("POST", _PATH, json=body)


def _multipart(case: _Case) -> httpx.Request:
    fields = {"model.name": case.task, "actions": orjson.dumps(_tensor(case.actions)).decode()}
    files = [("images", (f"{t}.png", png, "image/png")) for t, png in enumerate(_pngs(case))]
    return httpx.Request("POST", _PATH, data=fields, files=files)


def _pngs(case: _Case) -> list[bytes]:
    return [images.encode(frame).data for frame in case.frames]


def _tensor(array: npt.NDArray[Any]) -> dict[str, Any]:
    datatype, shape, raw = tensors.encode(array)
    return {"datatype": datatype, "shape": shape, "raw": base64.b64encode(raw).decode()}
