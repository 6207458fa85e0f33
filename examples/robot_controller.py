"""A robot follows a goal image: observations out and chunks of actions in, on one stream of the imitation service.

    freerein up
    python examples/robot_controller.py blocks goal.png

The robot is simulated; `Robot` has the two methods that a real one would have. `Controller` is all that a robot needs:
it sends an observation every control step, executes the newest chunk while that is valid, holds when there is none, and
goes on from its last state wherever the service, or another replica of it, comes back.
"""

import argparse
import asyncio
import logging
import time
from collections import deque
from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from freerein import images
from freerein.clients import Channel, ImitationClient, SimClient
from freerein.errors import DeadlineExceeded, Overloaded, Unavailable
from freerein.types.common import Camera, Goal, Image, ModelRef, Observation
from freerein.types.imitation import Chunk, ControlRequest, Hello, Observed
from freerein.types.sim import CreateSessionRequest, CreateSessionResponse, ResetRequest, StepRequest

_log = logging.getLogger(__name__)
_PAUSE_S = 0.1  # before another stream is opened
Action = npt.NDArray[np.float32]


class Controller:
    """Drives a robot to a goal.

    Args:
        robot: What sees and moves.
        policy: The imitation service.
        goal: What is to be achieved.
    """

    def __init__(self, robot: "Robot", policy: ImitationClient, goal: Goal) -> None:
        self._robot, self._policy, self._goal = robot, policy, goal
        self._done: list[Action] = []  # what was executed, whatever was proposed
        self._seen, self._is_new = Observed(0, Observation()), asyncio.Event()
        self._plan: deque[Action] = deque()  # what is left of the last chunk
        self._model, self._remembered = ModelRef(), 0  # whose state that chunk holds, and up to which step
        self.last: Chunk | None = None

    async def drive(self) -> None:
        """Returns when every goal is reached, or given up; raises a `ServiceError` that another try would not mend."""
        listening = asyncio.create_task(self._listen())
        try:
            while not listening.done():
                now_ns = time.monotonic_ns()
                self._seen = Observed(len(self._done), self._robot.observation(), observation_time_ns=now_ns)
                self._is_new.set()
                await asyncio.sleep(now_ns / 1e9 + self._robot.control_dt_s - time.monotonic())
                self._done.append(self._next_action())
                await self._robot.execute(self._done[-1])
        finally:
            listening.cancel()
            await asyncio.wait([listening])
        listening.result()

    def _next_action(self) -> Action:
        if self._plan and self.last and time.monotonic_ns() <= self.last.valid_until_ns:
            return self._plan.popleft()
        return np.zeros(self._robot.action.size, np.float32)  # it holds

    async def _listen(self) -> None:
        while True:
            try:
                async for reply in self._policy.control(self._say()):
                    if reply.spec:
                        self._model = reply.spec.model
                    elif reply.error:
                        _log.warning("step %d: %s", reply.seq, reply.error.detail)
                    elif reply.chunk:
                        self._plan, self._remembered, self.last = deque(reply.chunk.actions), reply.seq, reply.chunk
                        if not self._plan:
                            return  # nothing is left to do
            except (Unavailable, DeadlineExceeded, Overloaded) as error:
                _log.warning("step %d: %s", len(self._done), error.detail)
            await asyncio.sleep(_PAUSE_S)  # what is left of the plan is executed, then it holds

    async def _say(self) -> AsyncIterator[ControlRequest]:
        robot, told, state = self._robot, self._remembered, self.last.state if self.last else b""
        yield ControlRequest(Hello(self._goal, robot.cameras, robot.action, robot.control_dt_s, self._model, state))
        while await self._is_new.wait():
            self._is_new.clear()
            seen = self._seen
            executed = np.array(self._done[told : seen.seq], np.float32).reshape(-1, robot.action.size)
            told = seen.seq  # whether or not this one is answered: the service keeps count
            yield ControlRequest(observed=replace(seen, executed_actions=executed))


class Robot:
    """A simulated robot, seen by one camera. A real one knows its cameras and actions just as well.

    Args:
        sim: The sim service.
        session: One environment in it.
        frame: uint8 (H, W, C), what the camera sees.

    Attributes:
        cameras: What it sees with.
        action: What it takes an action to mean.
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
        """Returns what it sees now."""
        return Observation((images.encode(self._frame, encoding="raw_rgb8", camera=self.cameras[0].name),))

    async def execute(self, action: Action) -> None:
        """Executes an action, float32 (A,)."""
        self._steps += 1
        camera = self.cameras[0].name
        stepped = await self._sim.step(StepRequest(self._session, self._steps, action[None], (camera,)))
        self._frame = stepped.frames[camera][0]


async def start_robot(sim: SimClient, task: str, *, seed: int | None = None) -> Robot:
    """Returns a robot before a new episode of a task."""
    session = await sim.create_session(CreateSessionRequest(task, seed=seed))
    camera = session.task.cameras[0].name
    reset = await sim.reset(ResetRequest(session.session, cameras=(camera,)))
    return Robot(sim, session, reset.frames[camera][0])


async def main(task: str, goals: list[Path], sim_address: str, imitation_address: str) -> None:
    """Follows goal images, one after the other, and says how it went."""
    goal = Goal(tuple(Image(images.sniff(path.read_bytes()), 0, 0, path.read_bytes()) for path in goals))
    async with SimClient(Channel(sim_address)) as sim, ImitationClient(Channel(imitation_address)) as policy:
        controller = Controller(await start_robot(sim, task), policy, goal)
        await controller.drive()
        if controller.last is not None:
            _log.info("reached" if controller.last.goal_reached else "given up")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Drives a simulated robot to goal images.")
    parser.add_argument("task", help="a task of the sim service with continuous actions, such as blocks")
    parser.add_argument("goals", nargs="+", type=Path, help="image files")
    parser.add_argument("--sim", default="127.0.0.1:9104", help="gRPC address of the sim service")
    parser.add_argument("--imitation", default="127.0.0.1:9102", help="gRPC address of the imitation service")
    arguments = parser.parse_args()
    logging.basicConfig(level=logging.INFO)
    asyncio.run(main(arguments.task, arguments.goals, arguments.sim, arguments.imitation))
