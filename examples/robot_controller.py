"""A robot follows goal images by control stream: observations out, chunks of actions in.

    freerein up
    python examples/robot_controller.py blocks

The goal is what the robot saw on a short path, which it then follows from the start again; image files may be given
instead. The robot is simulated; `Robot` has the two methods of a real one. `Controller` is all that a robot needs: it
sends an observation every control step, executes the newest valid chunk, holds when there is none, and reconnects with
its last state when the service is away.
"""

import argparse
import asyncio
import logging
import sys
import time
from collections import deque
from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from freerein import images
from freerein.clients import Channel, ImitationClient, SimClient
from freerein.errors import DeadlineExceeded, Overloaded, ServiceError, Unavailable
from freerein.types.common import Camera, Goal, Image, ModelRef, Observation
from freerein.types.imitation import Chunk, ControlRequest, Hello, Observed
from freerein.types.sim import CreateSessionRequest, CreateSessionResponse, ResetRequest, StepRequest

_log = logging.getLogger(__name__)
_RECONNECT_DELAY_S = 0.1
_PATH = ((0, 0.5), (1, 0.5), (0, -0.5))  # index and value of an action's number, for each part of the path
_STEPS = 6  # of each part
_MAX_STEPS_PER_GOAL = 250  # more than the model's own: where a busy machine answers late, the robot holds
_OVER = "the newest actions are executed or too old, and no newer ones have come"
Action = npt.NDArray[np.float32]


class HoldLog:
    """Logs that a robot holds, each reason and that it goes on, once each, not at every control step."""

    def __init__(self) -> None:
        self._begun: int | None = None
        self._reasons: set[str] = set()

    def hold(self, step: int, reason: str) -> None:
        """Notes that the robot holds at a control step."""
        self._begun = step if self._begun is None else self._begun
        if reason not in self._reasons:
            self._reasons.add(reason)
            _log.warning("step %d: holds: %s", step, reason)

    def go_on(self, step: int) -> None:
        """Notes that the robot executes an action at a control step."""
        if self._begun is not None:
            _log.warning("step %d: goes on; it held for %d steps", step, step - self._begun)
        self._begun, self._reasons = None, set()


class Controller:
    """Controls a robot towards a goal.

    Args:
        robot: The robot.
        policy: Client of the imitation service.
        goal: The goal.
        max_steps_per_goal: Control steps after which a goal is abandoned for the next one; 0 for the model's own limit.
    """

    def __init__(self, robot: "Robot", policy: ImitationClient, goal: Goal, *, max_steps_per_goal: int = 0) -> None:
        self._robot, self._policy, self._goal = robot, policy, goal
        self._max_steps_per_goal = max_steps_per_goal
        self._executed: list[Action] = []  # since the observation of the last chunk's state
        self._first = 0  # control step of the first of these
        self._last_action: Action | None = None
        self._newest, self._is_new = Observed(0, Observation()), asyncio.Event()
        self._planned: deque[Action] = deque()  # rest of the last chunk
        self._model = ModelRef()  # of the last chunk's state
        self._holds, self._why_no_action = HoldLog(), "no actions have come yet"
        self.last: Chunk | None = None

    async def run(self) -> None:
        """Returns when every goal is over, reached or abandoned; raises a `ServiceError` that a retry would not fix."""
        receiving = asyncio.create_task(self._receive())
        try:
            while not receiving.done():
                now_ns = time.monotonic_ns()
                self._newest = Observed(self._step, self._robot.observation(), observation_time_ns=now_ns)
                self._is_new.set()
                await asyncio.sleep(now_ns / 1e9 + self._robot.control_dt_s - time.monotonic())
                self._last_action = self._next_action()
                self._executed.append(self._last_action)
                await self._robot.execute(self._last_action)
        finally:
            receiving.cancel()
            await asyncio.wait([receiving])
        receiving.result()

    @property
    def _step(self) -> int:
        """Control steps so far."""
        return self._first + len(self._executed)

    def _next_action(self) -> Action:
        step = self._step
        if self._planned and self.last and time.monotonic_ns() <= self.last.valid_until_ns:
            self._holds.go_on(step)
            return self._planned.popleft()
        self._holds.hold(step, self._why_no_action)
        is_held = self._robot.action.absolute and self._last_action is not None  # by the last target
        return self._last_action if is_held else self._robot.hold()

    async def _receive(self) -> None:
        while True:
            try:
                async for reply in self._policy.control(self._requests()):
                    if reply.spec:
                        self._model = reply.spec.model
                    elif reply.error:
                        self._why_no_action = reply.error.detail
                    elif reply.chunk:
                        if not len(reply.chunk.actions):
                            self.last = reply.chunk
                            return  # all goals are over
                        self._take(reply.chunk, reply.seq)
                        self._why_no_action = _OVER
            except (Unavailable, DeadlineExceeded, Overloaded) as error:
                self._why_no_action = error.detail
            await asyncio.sleep(_RECONNECT_DELAY_S)  # meanwhile the rest of the chunk is executed

    def _take(self, chunk: Chunk, step: int) -> None:
        """Plans the actions of a chunk for the observation before control step `step`."""
        del self._executed[: step - self._first]
        self._first = step
        late = min(len(self._executed), len(chunk.actions) - 1)  # actions whose time is over; the last one may be late
        self._planned, self.last = deque(chunk.actions[late:].copy()), chunk

    async def _requests(self) -> AsyncIterator[ControlRequest]:
        robot, sent, state = self._robot, self._first, self.last.state if self.last else b""
        hello = Hello(self._goal, robot.cameras, robot.action, robot.control_dt_s, self._model, state)
        yield ControlRequest(replace(hello, max_steps_per_goal=self._max_steps_per_goal))
        while await self._is_new.wait():
            self._is_new.clear()
            newest = self._newest
            recent = self._executed[sent - self._first : newest.seq - self._first]
            executed = np.array(recent, robot.action.dtype).reshape(-1, robot.action.size)
            sent = newest.seq  # answered or not: the service counts every observation's steps
            yield ControlRequest(observed=replace(newest, executed_actions=executed))


class Robot:
    """A simulated robot with one camera.

    Args:
        sim: Client of the sim service.
        session: A session of one environment.
        frame: First frame, uint8 (H, W, C).

    Attributes:
        cameras: Its cameras.
        action: Meaning of its actions.
        control_dt_s: Time between two actions, in seconds.
    """

    def __init__(self, sim: SimClient, session: CreateSessionResponse, frame: npt.NDArray[np.uint8]) -> None:
        self._sim = sim
        self._session = session.session
        self._frame = frame
        self._steps = 0
        self.cameras = (Camera(session.task.cameras[0].name, *frame.shape),)
        self.action = session.task.action
        self.control_dt_s = session.task.control_dt_s

    def observation(self) -> Observation:
        """Returns the current observation."""
        return Observation((images.encode(self._frame, encoding="raw_rgb8", camera=self.cameras[0].name),))

    def hold(self) -> Action:
        """Returns an action, (A,), that holds it before its first: no change, or a choice; of targets its place."""
        return self.action.hold_action()

    async def execute(self, action: Action) -> None:
        """Executes an action, float32 (A,); a robot that cuts it short writes into it what it did."""
        self._steps += 1
        camera = self.cameras[0].name
        stepped = await self._sim.step(StepRequest(self._session, self._steps, action[None], (camera,)))
        self._frame = stepped.frames[camera][0]


async def start_robot(sim: SimClient, task: str, *, seed: int | None = None) -> Robot:
    """Returns a robot at the start of an episode of a task."""
    session = await sim.create_session(CreateSessionRequest(task, seed=seed))
    camera = session.task.cameras[0].name
    reset = await sim.reset(ResetRequest(session.session, cameras=(camera,)))
    return Robot(sim, session, reset.frames[camera][0])


async def see_goals(robot: Robot) -> Goal:
    """Moves a robot on a short path; returns what it saw at the end of each part, as goals to reach in order."""
    seen: list[Image] = []
    for index, value in _PATH:
        action = np.zeros(robot.action.size, np.float32)
        action[index] = value
        for _ in range(_STEPS):
            await robot.execute(action)
        seen += robot.observation().images
    return Goal(tuple(seen))


def read_goals(paths: list[Path]) -> Goal:
    """Returns image files as goals to reach in order."""
    files = [path.read_bytes() for path in paths]
    return Goal(tuple(Image(images.sniff(data), 0, 0, data) for data in files))


async def main(task: str, seed: int, goals: list[Path], sim_address: str, imitation_address: str) -> None:
    """Reaches goal images one after the other and logs the outcome."""
    async with SimClient(Channel(sim_address)) as sim, ImitationClient(Channel(imitation_address)) as policy:
        goal = read_goals(goals) if goals else await see_goals(await start_robot(sim, task, seed=seed))
        robot = await start_robot(sim, task, seed=seed)
        controller = Controller(robot, policy, goal, max_steps_per_goal=_MAX_STEPS_PER_GOAL)
        await controller.run()
        if controller.last is not None:
            _log.info("reached" if controller.last.done_by == "policy" else "abandoned")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Controls a simulated robot towards goal images.")
    parser.add_argument("task", help="a task of the sim service with continuous actions, such as blocks")
    parser.add_argument("goals", nargs="*", type=Path, help="image files; none for what it saw on a short path")
    parser.add_argument("--seed", type=int, default=7, help="seed of the scene")
    parser.add_argument("--sim", default="127.0.0.1:9104", help="gRPC address of the sim service")
    parser.add_argument("--imitation", default="127.0.0.1:9102", help="gRPC address of the imitation service")
    arguments = parser.parse_args()
    logging.basicConfig(level=logging.INFO)
    try:
        asyncio.run(main(arguments.task, arguments.seed, arguments.goals, arguments.sim, arguments.imitation))
    except ServiceError as error:
        sys.exit(f"{error.detail}\n{error.hint}")
