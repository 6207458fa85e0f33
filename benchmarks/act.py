"""Latency of one action through each interface of the imitation service, beside the bare model and a bare server.

One robot sends one observation after the other, each a raw image. `control` and `grpc` are calls of the Python client
from arrays to arrays, `json` is a REST call from a prepared body to the parsed reply, and `control-bytes` is the stream
of `control` with prepared messages and replies left undecoded. The baselines:

    torch          the model call in process, as the service's core makes it
    bare-policy    a bare gRPC stream, also with prepared messages, whose server makes the model call and no more

The overhead of an interface over the model call is relative to that of `bare-policy`:
(interface - torch) / (bare-policy - torch).
"""

import base64
from collections.abc import Awaitable, Callable, Iterator
from contextlib import AsyncExitStack
from itertools import count
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
import orjson

from benchmarks.bare_policy import SEQ_BYTES, STREAM, grpc_stream
from benchmarks.imitation_robot import CONTROL, NEVER_STEPS, Observe, Scene, control_stream, policy_step, publish_scene
from benchmarks.report import Ratio, Results
from benchmarks.servers import rest_call, rest_client, run_server, run_service
from benchmarks.timing import Call, Effort, Latencies, measure_latencies
from freerein import wire
from freerein.clients import Channel, ImitationClient
from freerein.types.imitation import ActRequest

_SIDES_PX = (64, 224)
_INTERFACES = ("control-bytes", "control", "grpc", "json")
_LIMITS = {"control-bytes": 1.5}
_TOLERANCE = 1e-5

Actions: TypeAlias = npt.NDArray[np.float32]
Act: TypeAlias = Callable[[], Awaitable[Actions]]


async def measure(effort: Effort) -> Results:
    """Returns the overhead of each interface over the model call, for each image size, and all latencies."""
    results = Results()
    with TemporaryDirectory() as folder:
        scenes = [publish_scene(side_px, Path(folder)) for side_px in _SIDES_PX]
        async with run_service("imitation", data_dir=Path(folder)) as stack:
            for scene in scenes:
                results += await _measure(scene, stack.addresses["imitation"], stack.urls["imitation"], effort)
    return results


async def _measure(scene: Scene, address: str, url: str, effort: Effort) -> Results:
    async with AsyncExitStack() as opened:
        rest = await opened.enter_async_context(rest_client(url))
        client = await opened.enter_async_context(ImitationClient(Channel(address)))
        observe = await opened.enter_async_context(control_stream(client, scene))
        request = ActRequest(scene.observation(), scene.goal_image(), max_steps_per_goal=NEVER_STEPS, model=scene.ref)

        step = policy_step(scene)

        async def torch() -> Actions:
            actions: Actions = step().actions[0]
            return actions

        async def grpc() -> Actions:
            actions: Actions = (await client.act(request)).actions
            return actions

        json = rest_call(rest, "/v1/act", orjson.dumps(wire.to_json(request)), _parse_actions)
        decoded: dict[str, Act] = {"torch": torch, "grpc": grpc, "json": json}
        await _check_same_actions(decoded, observe)
        bare = await _open_bare(opened, scene, address)
        times = await measure_latencies({"control": observe, **decoded, **bare}, effort)
    case = scene.ref.name
    overheads = (
        Ratio(f"act.{each}_adds_vs_bare_policy.{case}", _overhead(times, each), at_most=_LIMITS.get(each))
        for each in _INTERFACES
    )
    totals = (
        Ratio(f"act.{each}_vs_bare_policy.{case}", times.ratio(each, over="bare-policy", share=0.5))
        for each in _INTERFACES
    )
    return Results(ratios=(*overheads, *totals), latencies={f"act.{case}": times})


async def _open_bare(opened: AsyncExitStack, scene: Scene, address: str) -> dict[str, Call]:
    """Returns the calls of bare clients, to the service and to the bare server, open as long as the stack is."""
    port = await opened.enter_async_context(run_server("benchmarks.bare_policy", str(scene.folder)))
    observations, hello = scene.observed_bytes(), scene.hello_bytes()
    frames, goal = _numbered(scene.frame.tobytes()), scene.goal.tobytes()
    calls = {
        "control-bytes": grpc_stream(address, CONTROL, observations, first=hello, first_is_answered=True),
        "bare-policy": grpc_stream(f"127.0.0.1:{port}", STREAM, frames, first=goal),
    }
    return {name: await opened.enter_async_context(call) for name, call in calls.items()}


def _numbered(frame: bytes) -> Iterator[bytes]:
    return (seq.to_bytes(SEQ_BYTES, "little") + frame for seq in count())


def _overhead(times: Latencies, interface: str) -> float:
    """Returns the overhead of an interface over that of the bare server: the median of the rounds' p50 ratios."""
    ours, torch, bare = (times.quantiles(each, 0.5) for each in (interface, "torch", "bare-policy"))
    return median((our - call) / (their - call) for our, call, their in zip(ours, torch, bare, strict=True))


async def _check_same_actions(interfaces: dict[str, Act], observe: Observe) -> None:
    """Raises if the first actions differ, which do not depend on memory."""
    chunk = (await observe()).chunk
    for name, act in interfaces.items():
        if chunk is None or not np.allclose(await act(), chunk.actions, atol=_TOLERANCE):
            raise RuntimeError(f"All interfaces must return the same actions; {name} and the stream differ.")


def _parse_actions(reply: Any) -> Actions:
    actions = reply["actions"]
    return np.frombuffer(base64.b64decode(actions["raw"]), np.float32).reshape(actions["shape"])
