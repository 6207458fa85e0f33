"""How long an action takes through each door of the imitation service, beside the bare model and bare transports.

One robot sends one observation after the other, each a raw image. `control` and `grpc` are calls from arrays to arrays
by the client that users have, `json` is a REST call from a body that is ready to the parsed reply, and
`control-bytes` is the same stream as `control` to a client that has its messages ready and does not read the replies.
So have the clients of what stands beside:

    torch            the model's call, in process, as the service's core makes it
    floor-stream     a bare gRPC stream: the same image one way, and as many bytes as of a reply the other
    floor-websocket  a bare websocket with msgpack that carries the same
    floor-policy     a bare gRPC stream whose server makes the model's call
    floor-threaded   the same, with that call on a thread

What a way adds to the model's call is counted in what `floor-policy` adds: (way - torch) / (floor-policy - torch).
That one makes the call on its event loop, where it holds up everybody else, and answers with the action and what is
remembered, which is all of a reply but a tenth. `floor-threaded` is what it costs not to hold up others.
"""

import base64
from collections.abc import Awaitable, Callable, Iterator
from contextlib import AsyncExitStack
from itertools import count, repeat
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any, TypeAlias

import httpx
import numpy as np
import numpy.typing as npt
import orjson

from benchmarks import floors
from benchmarks.controlling import CONTROL, Robot, controlling
from benchmarks.exchanges import Exchange, grpc_stream, websocket
from benchmarks.latencies import Caller, Latencies, time_calls
from benchmarks.policies import NEVER_STEPS, Scene, publish
from benchmarks.processes import serving
from benchmarks.report import Bar, Findings, Ratio
from benchmarks.rounds import Effort
from benchmarks.services import running
from freerein import wire
from freerein.clients import Channel, ImitationClient
from freerein.types.imitation import ActRequest
from freerein_imitation.model import goal_conditioned_policy

_SIDES_PX = (64, 224)
_TIMEOUT_S = 60.0
_PATH = "/v1/act"
_CLOSE = 1e-5
_FLOORS = "benchmarks.floors"

Actions: TypeAlias = npt.NDArray[np.float32]
Act: TypeAlias = Callable[[], Awaitable[Actions]]


async def measure(effort: Effort) -> Findings:
    """Returns what the service adds to the model's call, by size of the images, and every way's latency."""
    found = Findings()
    with TemporaryDirectory() as folder:
        scenes = [publish(side_px, Path(folder)) for side_px in _SIDES_PX]
        async with running("imitation", data_dir=Path(folder)) as stack:
            for scene in scenes:
                found += await _measure(scene, stack.addresses["imitation"], stack.urls["imitation"], effort)
    return found


async def _measure(scene: Scene, address: str, url: str, effort: Effort) -> Findings:
    async with AsyncExitStack() as opened:
        rest = await opened.enter_async_context(httpx.AsyncClient(base_url=url, timeout=_TIMEOUT_S, trust_env=False))
        client = await opened.enter_async_context(ImitationClient(Channel(address)))
        robot = await opened.enter_async_context(controlling(client, scene))
        doors = {"torch": _torch(scene), "grpc": _unary(client, scene), "json": _poster(rest, scene)}
        await _check_same_actions(doors, robot)
        bare = await _open_bare(opened, scene, address, reply_bytes=wire.pack(await robot.answer()).ByteSize())
        callers = [Caller("control", robot.answer), *(Caller(*each) for each in (*doors.items(), *bare.items()))]
        return _findings(await time_calls(callers, effort), scene.ref.name)


async def _open_bare(opened: AsyncExitStack, scene: Scene, address: str, *, reply_bytes: int) -> dict[str, Exchange]:
    """Returns what bare clients do, for as long as the stack is open: to the service, and to servers as bare."""
    frame, loopback = scene.frame.tobytes(), "127.0.0.1"
    size, model = str(reply_bytes), str(scene.folder)
    echo, socket, policy, threaded = [
        await opened.enter_async_context(serving(_FLOORS, kind, argument))
        for kind, argument in (("stream", size), ("websocket", size), ("policy", model), ("threaded", model))
    ]
    exchanges = {
        "control-bytes": grpc_stream(address, CONTROL, scene.observations(), hello=scene.greeting(), is_greeted=True),
        "floor-policy": grpc_stream(
            f"{loopback}:{policy}", floors.STREAM, _numbered(frame), hello=scene.goal.tobytes()
        ),
        "floor-threaded": grpc_stream(
            f"{loopback}:{threaded}", floors.STREAM, _numbered(frame), hello=scene.goal.tobytes()
        ),
        "floor-stream": grpc_stream(f"{loopback}:{echo}", floors.STREAM, repeat(frame)),
        "floor-websocket": websocket(f"ws://{loopback}:{socket}", frame),
    }
    return {name: await opened.enter_async_context(exchange) for name, exchange in exchanges.items()}


def _numbered(frame: bytes) -> Iterator[bytes]:
    return (seq.to_bytes(floors.SEQ_BYTES, "little") + frame for seq in count())


def _findings(times: Latencies, case: str) -> Findings:
    bars = {("control-bytes", "policy"): Bar("at most", 1.5)}
    added = (
        Ratio(f"act.{way}_adds_vs_bare_{floor}.{case}", _added(times, way, f"floor-{floor}"), bars.get((way, floor)))
        for floor in ("policy", "threaded")
        for way in _WAYS
    )
    whole = (Ratio(f"act.{way}_vs_bare_policy.{case}", _whole(times, way)) for way in _WAYS)
    return Findings(ratios=(*added, *whole), latencies={f"act.{case}": times})


_WAYS = ("control-bytes", "control", "grpc", "json")


def _added(times: Latencies, way: str, floor: str) -> float:
    """Returns what a way adds to the model's call over what a bare server adds: the median of the rounds' p50s."""
    ours, torch, least = (times.quantiles(each, 0.5) for each in (way, "torch", floor))
    return median((our - call) / (bare - call) for our, call, bare in zip(ours, torch, least, strict=True))


def _whole(times: Latencies, way: str) -> float:
    return times.ratio(way, over="floor-policy", share=0.5)


async def _check_same_actions(doors: dict[str, Act], robot: Robot) -> None:
    """Raises where ways differ in the first action, before which there is nothing to remember."""
    chunk = (await robot.answer()).chunk
    for name, act in doors.items():
        if chunk is None or not np.allclose(await act(), chunk.actions, atol=_CLOSE):
            raise RuntimeError(f"All doors must answer as the model does; {name} and the stream differ.")


def _torch(scene: Scene) -> Act:
    """Returns the model's call as the service's core makes it, which brings back what it remembers."""
    policy = goal_conditioned_policy.load(scene.folder, "cpu")
    frames, goals = scene.frame[None], policy.encode_goals(scene.goal[None])
    previous, memory = np.zeros((1, policy.action_size), np.float32), np.zeros((1, policy.memory_size), np.float32)

    async def act() -> Actions:
        nonlocal memory
        step = policy.step(frames, goals, previous, memory)
        memory = step.memory
        actions: Actions = step.actions[0]
        return actions

    return act


def _unary(client: ImitationClient, scene: Scene) -> Act:
    async def act() -> Actions:
        actions: Actions = (await client.act(_request(scene))).actions
        return actions

    return act


def _poster(client: httpx.AsyncClient, scene: Scene) -> Act:
    """Returns what sends a REST call whose body, in JSON with raw images in base64, is ready."""
    body, headers = orjson.dumps(wire.to_json(_request(scene))), {"content-type": "application/json"}

    async def act() -> Actions:
        response = await client.post(_PATH, content=body, headers=headers)
        response.raise_for_status()
        actions: dict[str, Any] = orjson.loads(response.content)["actions"]
        return np.frombuffer(base64.b64decode(actions["raw"]), np.float32).reshape(actions["shape"])

    return act


def _request(scene: Scene) -> ActRequest:
    return ActRequest(scene.seen, scene.wanted, max_steps_per_goal=NEVER_STEPS, model=scene.ref)
