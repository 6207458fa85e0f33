"""The calls that `benchmarks.peers` compares: `python -m benchmarks.peer_calls EFFORT` prints their latencies as JSON.

It runs in the environment of `benchmarks.peer_environment`.
"""

import asyncio
import base64
import json
import sys
from collections.abc import AsyncGenerator, Callable, Iterator
from contextlib import AsyncExitStack, asynccontextmanager, closing, contextmanager
from dataclasses import replace
from http import HTTPStatus
from http.client import HTTPConnection
from itertools import chain, repeat
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, cast

import numpy as np
import numpy.typing as npt
import orjson
import torch
from openpi_client.websocket_client_policy import WebsocketClientPolicy
from vla_eval.connection import Connection
from vla_eval.protocol.numpy_codec import set_image_format

from benchmarks.act import Actions, torch_call
from benchmarks.imitation_robot import NEVER_STEPS, Observe, Scene, control_stream, publish_scene
from benchmarks.servers import run_server, run_service
from benchmarks.timing import Call, Effort, Latencies, measure_latencies
from freerein import wire
from freerein.clients import Channel, ImitationClient
from freerein.types.imitation import ActRequest
from freerein_imitation.methods import METHODS
from freerein_imitation.model.policy import PolicyOutput

_SIDES_PX = (64, 224)
_TOLERANCE = 1e-4


def main() -> None:
    """Measures and prints."""
    torch.set_num_threads(1)
    set_image_format("raw")
    effort = Effort(**json.loads(sys.argv[1]))
    sys.stdout.write(json.dumps(asyncio.run(_measure_all(effort))))


async def _measure_all(effort: Effort) -> dict[str, dict[str, list[list[float]]]]:
    """Returns the latencies by image size, call and round, in seconds."""
    measured = {}
    with TemporaryDirectory() as folder:
        scenes = [publish_scene(side_px, Path(folder)) for side_px in _SIDES_PX]
        async with run_service("imitation", data_dir=Path(folder)) as stack:
            for scene in scenes:
                times = await _measure(scene, stack.addresses["imitation"], stack.urls["imitation"], effort)
                rounds = {name: [turn.tolist() for turn in turns] for name, turns in times.seconds.items()}
                measured[scene.ref.name] = rounds
    return measured


async def _measure(scene: Scene, address: str, url: str, effort: Effort) -> Latencies:
    async with AsyncExitStack() as opened:
        enter = opened.enter_async_context
        client = await enter(ImitationClient(Channel(address)))
        first, second = _steps(scene)
        start = ActRequest(scene.observation(), scene.goal_image(), max_steps_per_goal=NEVER_STEPS, model=scene.ref)
        later = replace(start, executed_actions=_executed(scene), state=(await client.act(start)).state)
        streams: dict[str, Call] = {
            "control": _control(await enter(control_stream(client, scene))),
            "websocket": _openpi(scene, url),
            "vla-eval": await enter(_vla_eval(scene)),
        }
        replies: dict[str, Call] = {
            "json": opened.enter_context(_post(url, "/v1/act", orjson.dumps(wire.to_json(later)), _parse_ours)),
            "litserve": await enter(_litserve(scene, first.recurrent)),
        }
        await _check_actions(streams, first.actions[0])
        await _check_actions(replies, second.actions[0])
        return await measure_latencies({"torch": torch_call(scene), **streams, **replies}, effort)


def _steps(scene: Scene) -> tuple[PolicyOutput, PolicyOutput]:
    """Returns the policy's output at the start, and then once more."""
    policy = METHODS.load(scene.folder, "cpu")
    (camera,) = policy.spec.cameras
    frames, goals = {camera.name: scene.frame[None]}, policy.encode_goals({camera.name: scene.goal[None]})
    first = policy.step(frames, goals, _executed(scene), np.zeros((1, policy.spec.recurrent_size), np.float32))
    return first, policy.step(frames, goals, _executed(scene), first.recurrent)


async def _check_actions(calls: dict[str, Call], expected: Actions) -> None:
    for name, call in calls.items():
        if not np.allclose(cast(Actions, await call()), expected, atol=_TOLERANCE):
            raise RuntimeError(f"All servers must return the policy's actions; those of {name} differ.")


def _executed(scene: Scene) -> Actions:
    """Returns one executed action, which is none."""
    return np.zeros((1, scene.action.size), np.float32)


def _control(observe: Observe) -> Call:
    async def call() -> Actions:
        chunk = (await observe()).chunk
        return np.empty(0, np.float32) if chunk is None else chunk.actions

    return call


def _openpi(scene: Scene, url: str) -> Call:
    """Returns the call of openpi's client, which blocks. The goal is in its first message."""
    query = f"model.name={scene.ref.name}&max_steps_per_goal={NEVER_STEPS}"
    policy = WebsocketClientPolicy(f"{url.replace('http', 'ws', 1)}/?{query}")
    observation = {f"observation/{scene.camera}": scene.frame, "executed_actions": _executed(scene)}
    messages = chain([{**observation, f"goal/{scene.camera}": scene.goal}], repeat(observation))

    async def call() -> Actions:
        return cast(Actions, policy.infer(next(messages))["actions"])

    return call


@asynccontextmanager
async def _vla_eval(scene: Scene) -> AsyncGenerator[Call, None]:
    """Yields the call of vla-eval's client, in an episode whose start told the server the goal."""
    observation = {"image": scene.frame, "executed_actions": _executed(scene)}
    async with (
        run_server("benchmarks.peer_servers", "vla-eval", str(scene.folder)) as port,
        Connection(f"ws://127.0.0.1:{port}") as connection,
    ):
        await connection.start_episode({"goal": scene.goal})

        async def call() -> Actions:
            return cast(Actions, (await connection.act(observation))["actions"])

        yield call


@asynccontextmanager
async def _litserve(scene: Scene, memory: npt.NDArray[np.float32]) -> AsyncGenerator[Call, None]:
    """Yields the call of LitServe."""
    parts: dict[str, npt.NDArray[Any]] = {"image": scene.frame, "goal": scene.goal}
    parts |= {"executed_actions": _executed(scene), "state": memory}
    body = orjson.dumps({name: base64.b64encode(part.tobytes()).decode() for name, part in parts.items()})
    async with run_server("benchmarks.peer_servers", "litserve", str(scene.folder)) as port:
        with _post(f"http://127.0.0.1:{port}", "/predict", body, _parse_theirs) as call:
            yield call


@contextmanager
def _post(url: str, path: str, body: bytes, parse: Callable[[Any], Actions]) -> Iterator[Call]:
    """Yields a call over Python's own HTTP client, which blocks, and takes milliseconds less than httpx."""
    with closing(HTTPConnection(url.removeprefix("http://"))) as connection:

        async def call() -> Actions:
            connection.request("POST", path, body, {"Content-Type": "application/json"})
            response = connection.getresponse()
            if response.status != HTTPStatus.OK:
                raise RuntimeError(f"{url}{path} must answer with 200; got {response.status}.")
            return parse(orjson.loads(response.read()))

        yield call


def _parse_ours(reply: Any) -> Actions:
    return _array(reply["actions"]["raw"]).reshape(reply["actions"]["shape"])


def _parse_theirs(reply: Any) -> Actions:
    return _array(reply["actions"]).reshape(1, -1)


def _array(text: str) -> Actions:
    return np.frombuffer(base64.b64decode(text), np.float32)


if __name__ == "__main__":
    main()
