"""The example's robot over real services, one of which is killed: it holds, goes on, and executes nothing expired."""

import asyncio
import re
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from examples import robot_controller
from tests.waiting import wait_until

from freerein.clients import Channel, ImitationClient, SimClient
from freerein.errors import InvalidInput, Unauthenticated
from freerein.learning.model_files import save_model
from freerein.model_store import ModelStore
from freerein.types.common import ActionSpec, Camera, Goal, Image
from freerein.types.imitation import ControlResponse
from freerein_imitation.methods.goal_conditioned.network import GoalConditionedNetwork, GoalConditionedSpec
from freerein_imitation.model.policy import ControlSpec

pytestmark = pytest.mark.e2e
GOAL = Goal((Image("raw_rgb8", 64, 64, bytes(64 * 64 * 3)),))
ACTION = ActionSpec(3, 0, ("dy", "dz", "gripper"), "m", (0.05, 0.05, 0.02))


def publish_policy(data_dir: Path, *, reached_threshold: float) -> None:
    """Puts an untrained policy in the store: it moves somehow, and is soon or never content."""
    torch.manual_seed(0)
    cameras = (Camera("front", 64, 64, 3),)
    spec = GoalConditionedSpec(cameras=cameras, action=ACTION, features=8, hidden_size=8, embedding_size=4)
    control = ControlSpec(0.04, reached_threshold, 100_000)
    network = GoalConditionedNetwork(spec)
    frames = {"front": torch.randint(0, 256, (16, 64, 64, 3), dtype=torch.uint8)}
    network.fit_normalisation(frames, generator=torch.Generator())
    save_model(network, data_dir / "new", card={"method": "goal_conditioned", **control.to_card()})
    store = ModelStore(data_dir / "models" / "imitation")
    store.activate(store.publish("", data_dir / "new"))


class Recorder:
    """A policy's client that writes down what was answered, and a robot that writes down what was executed when."""

    def __init__(self, robot: Any, client: ImitationClient, goal: Goal) -> None:
        self.chunks: list[Any] = []
        self.executed: list[tuple[int, bytes]] = []
        self._client = client
        self._execute = robot.execute
        robot.execute = self.execute
        self.controller = robot_controller.Controller(robot, self, goal)

    async def control(self, requests: Any) -> Any:
        async for reply in self._client.control(requests):
            self.note(reply)
            yield reply

    def note(self, reply: ControlResponse) -> None:
        assert reply.error is None
        if reply.chunk is not None:
            self.chunks.append(reply)

    async def execute(self, action: Any) -> None:
        self.executed.append((time.monotonic_ns(), action.tobytes()))
        await self._execute(action)


@pytest.fixture(scope="module")
def sim(start_module_service: Callable[..., Any]) -> str:
    """The address of the sim service."""
    return str(start_module_service("freerein_sim", FREEREIN_SIM_WORKERS="1").until_ready().address)


@pytest.fixture
def start(start_service: Callable[..., Any], tmp_path: Path) -> Callable[..., Any]:
    """Starts the imitation service, ready."""

    async def start_imitation(**environ: str) -> Any:
        return await asyncio.to_thread(start_service("freerein_imitation", tmp_path, **environ).until_ready)

    return start_imitation


@pytest.mark.fault("I7")
@pytest.mark.fault("I8")
async def test_a_robot_holds_while_the_service_is_dead_then_goes_on_and_executes_nothing_that_expired(
    sim: str, start: Callable[..., Any], tmp_path: Path
) -> None:
    publish_policy(tmp_path, reached_threshold=1.0)
    service = await start()
    async with SimClient(Channel(sim)) as worlds, ImitationClient(Channel(service.address)) as client:
        recorder = Recorder(await robot_controller.start_robot(worlds, "blocks", seed=1), client, GOAL)
        driving = asyncio.create_task(recorder.controller.run())
        await until(lambda: len(moves(recorder.executed)) >= 20)
        service.kill()
        steps = len(recorder.executed)
        await until(lambda: len(recorder.executed) >= steps + 10 and not any(moves(recorder.executed[-5:])))
        held = len(recorder.executed)
        await start(FREEREIN_GRPC_PORT=service.address.rpartition(":")[2])
        chunks = len(recorder.chunks)
        await until(lambda: len(recorder.chunks) >= chunks + 10 and any(moves(recorder.executed[held:])))
        driving.cancel()
    check_record(recorder)


async def test_a_robot_stops_at_its_goal(sim: str, start: Callable[..., Any], tmp_path: Path) -> None:
    publish_policy(tmp_path, reached_threshold=0.0)
    service = await start()
    async with SimClient(Channel(sim)) as worlds, ImitationClient(Channel(service.address)) as client:
        controller = robot_controller.Controller(
            await robot_controller.start_robot(worlds, "blocks", seed=1), client, GOAL
        )
        await asyncio.wait_for(controller.run(), 300)
    assert controller.last.goal_reached


async def test_it_runs_as_its_docstring_says_and_reaches_its_goal(sim: str, start: Callable[..., Any]) -> None:
    services = ["--sim", sim, "--imitation", (await start()).address]  # with the shipped models
    start_line, command = re.findall(r"^    (\S.*)$", robot_controller.__doc__, re.MULTILINE)
    python, script, *arguments = command.split()
    assert (start_line, python) == ("freerein up", "python")
    run = [sys.executable, Path(__file__).parents[2] / script, *arguments, *services]
    ran = await asyncio.to_thread(subprocess.run, run, capture_output=True, text=True, check=False, timeout=300)
    assert (ran.returncode, ran.stderr.splitlines()[-1:]) == (0, ["INFO:__main__:reached"]), ran.stderr


async def test_what_another_try_would_not_mend_ends_the_drive(
    sim: str, start: Callable[..., Any], tmp_path: Path
) -> None:
    publish_policy(tmp_path, reached_threshold=1.0)
    service = await start(FREEREIN_TOKEN="secret")
    small = Goal((Image("raw_rgb8", 32, 32, bytes(32 * 32 * 3)),))
    async with SimClient(Channel(sim)) as worlds:
        robot = await robot_controller.start_robot(worlds, "blocks", seed=1)
        for token, goal, expected in (("secret", small, InvalidInput), ("guess", GOAL, Unauthenticated)):
            async with ImitationClient(Channel(service.address, token=token)) as client:
                with pytest.raises(expected):
                    await asyncio.wait_for(robot_controller.Controller(robot, client, goal).run(), 300)


def check_record(recorder: Recorder) -> None:
    proposed = {chunk.chunk.actions[0].tobytes(): chunk.chunk for chunk in recorder.chunks if len(chunk.chunk.actions)}
    moved = moves(recorder.executed)
    assert len(moved) >= 20
    assert all(at_ns <= proposed[action].valid_until_ns + 10**9 for at_ns, action in moved)  # on a busy machine
    assert len({action for _, action in moved}) == len(moved), "nothing is executed twice"
    indices = [reply.seq for reply in recorder.chunks]
    assert indices == sorted(set(indices))


def moves(executed: list[tuple[int, bytes]]) -> list[tuple[int, bytes]]:
    """Returns what was executed, without holds."""
    return [(at_ns, action) for at_ns, action in executed if action != bytes(12)]


async def until(condition: Callable[[], bool]) -> None:
    await asyncio.to_thread(wait_until, condition)
