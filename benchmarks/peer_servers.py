"""Other projects' policy servers around a policy of ours: `python -m benchmarks.peer_servers KIND FOLDER`.

vla-eval   its server of models for a robot's loop, over a WebSocket; it calls the policy on a thread
litserve   its server of models over HTTP, with JSON whose arrays are base64, as our REST API has them

Each does what our service does of one robot's call and no more: the goal's code is computed once, the memory is the
session's (vla-eval) or the caller's (LitServe). It runs in the environment of `benchmarks.peer_environment`.
"""

import argparse
import asyncio
import base64
import os
import signal
import sys
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TextIO

import httpx
import litserve
import numpy as np
import numpy.typing as npt
import torch
from vla_eval.model_servers.base import SessionContext
from vla_eval.model_servers.predict import PredictModelServer
from vla_eval.model_servers.serve import serve_async

from benchmarks.servers import serve_until_stdin_closes
from freerein.cli.services import free_ports
from freerein_imitation.methods import METHODS
from freerein_imitation.model.policy import Policy

_LOOPBACK = "127.0.0.1"
_POLL_S = 0.05


def main() -> None:
    """Serves until stdin closes."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.peer_servers", description="A peer's server.")
    parser.add_argument("kind", choices=_SERVERS)
    parser.add_argument("folder", type=Path)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    _SERVERS[arguments.kind](arguments.folder)


class VlaEvalServer(PredictModelServer):  # type: ignore[misc]  # untyped here
    """A policy of ours as vla-eval's model server."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._policy, self._camera = _load(folder)
        self._goals: dict[str, npt.NDArray[np.float32]] = {}
        self._memory: dict[str, npt.NDArray[np.float32]] = {}

    async def on_episode_start(self, config: Mapping[str, Any], ctx: SessionContext) -> None:
        """Keeps the goal."""
        await super().on_episode_start(config, ctx)
        self._goals[ctx.session_id] = self._policy.encode_goals({self._camera: config["goal"][None]})
        self._memory[ctx.session_id] = np.zeros((1, self._policy.spec.recurrent_size), np.float32)

    def predict(self, obs: Mapping[str, Any], ctx: SessionContext) -> Mapping[str, Any]:
        """Returns the next actions."""
        session, frames = ctx.session_id, {self._camera: obs["image"][None]}
        step = self._policy.step(frames, self._goals[session], obs["executed_actions"], self._memory[session])
        self._memory[session] = step.recurrent
        return {"actions": step.actions[0], "goal_confidence": float(step.reached[0])}


class LitServeAPI(litserve.LitAPI):  # type: ignore[misc]  # untyped here
    """A policy of ours as LitServe's API."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._folder = folder

    def setup(self, device: str) -> None:
        """Loads the policy in LitServe's worker process."""
        torch.set_num_threads(1)
        self._policy, self._camera = _load(self._folder)
        self._goals: dict[str, npt.NDArray[np.float32]] = {}

    def decode_request(self, request: Mapping[str, Any]) -> tuple[Any, ...]:
        """Returns frame, goal's code, executed action and memory."""
        spec, goal = self._policy.spec, request["goal"]
        shape = (1, spec.cameras[0].height, spec.cameras[0].width, spec.cameras[0].channels)
        if goal not in self._goals:
            self._goals[goal] = self._policy.encode_goals({self._camera: _array(goal, np.uint8).reshape(shape)})
        memory = _array(request["state"], np.float32).reshape(1, -1)
        executed = _array(request["executed_actions"], np.float32).reshape(1, -1)
        return _array(request["image"], np.uint8).reshape(shape), self._goals[goal], executed, memory

    def predict(self, inputs: tuple[Any, ...]) -> Any:
        """Returns the policy's output."""
        frames, goal, executed, memory = inputs
        return self._policy.step({self._camera: frames}, goal, executed, memory)

    def encode_response(self, output: Any) -> Mapping[str, Any]:
        """Returns actions and memory as JSON."""
        return {
            "actions": base64.b64encode(output.actions[0].tobytes()).decode(),
            "state": base64.b64encode(output.recurrent.tobytes()).decode(),
            "goal_confidence": float(output.reached[0]),
        }


def _load(folder: Path) -> tuple[Policy, str]:
    policy = METHODS.load(folder, "cpu")
    return policy, policy.spec.cameras[0].name


def _array(text: str, dtype: Any) -> npt.NDArray[Any]:
    return np.frombuffer(base64.b64decode(text), dtype)


def _serve_vla_eval(folder: Path) -> None:
    async def serve() -> None:
        listening: asyncio.Future[int] = asyncio.get_running_loop().create_future()
        status = SimpleNamespace(started=listening.set_result)
        serving = asyncio.create_task(serve_async(VlaEvalServer(folder), _LOOPBACK, 0, task_status=status))
        await serve_until_stdin_closes(await listening)
        serving.cancel()

    asyncio.run(serve())


def _serve_litserve(folder: Path) -> None:
    port = free_ports(["imitation"])["imitation"].rest
    server = litserve.LitServer(LitServeAPI(folder), accelerator="cpu", workers_per_device=1)
    parent = os.fdopen(os.dup(sys.stdout.fileno()), "w")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # where LitServe logs
    threading.Thread(target=_announce, args=(port, parent), daemon=True).start()
    server.run(host=_LOOPBACK, port=port, generate_client_file=False, log_level="warning")


def _announce(port: int, parent: TextIO) -> None:
    """Tells the parent the port once LitServe is ready; stops it when the parent closes the pipe, or ends."""
    with httpx.Client(trust_env=False) as client:
        while not _is_ready(client, f"http://{_LOOPBACK}:{port}/health"):
            time.sleep(_POLL_S)
    parent.write(f"{port}\n")
    parent.flush()
    sys.stdin.buffer.read()
    os.kill(os.getpid(), signal.SIGINT)


def _is_ready(client: httpx.Client, url: str) -> bool:
    try:
        return client.get(url).is_success
    except httpx.HTTPError:
        return False


_SERVERS = {"vla-eval": _serve_vla_eval, "litserve": _serve_litserve}


if __name__ == "__main__":
    main()
