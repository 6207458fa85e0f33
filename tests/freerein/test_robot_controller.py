"""What the example's controller logs of holds, with a policy whose answers are written down here."""

import logging
import re
import time
from collections.abc import AsyncIterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from examples import robot_controller

from freerein.errors import Unavailable
from freerein.types.common import ActionSpec, Camera, Error, Goal, Observation
from freerein.types.imitation import Chunk, ControlRequest, ControlResponse

HORIZON_NS = 60_000_000_000


class OwnRobot:
    """A robot that counts its control steps."""

    cameras = (Camera("front", 8, 8, 3),)
    action = ActionSpec(2, 0, ("dy", "dz"), "m", (0.05, 0.05))
    control_dt_s = 0.002

    def __init__(self) -> None:
        self.executed: list[Any] = []

    def observation(self) -> Observation:
        return Observation()

    def hold(self) -> Any:
        return np.zeros(2, np.float32)

    async def execute(self, action: Any) -> None:
        action *= 0.5  # its limits cut actions short
        self.executed.append(action)


class Policy:
    """Answers the observations of each stream as a script says: a number of actions, an error's words, or none."""

    def __init__(self, *streams: tuple[int | str | None, ...]) -> None:
        self._streams = iter(streams)

    async def control(self, requests: AsyncIterator[ControlRequest]) -> AsyncIterator[ControlResponse]:
        await anext(requests)
        for answer in next(self._streams):
            seen = (await anext(requests)).observed
            assert seen is not None
            if isinstance(answer, int):
                actions = np.ones((answer, 2), np.float32)
                yield ControlResponse(seen.seq, chunk=chunk(actions))
            elif answer:
                yield ControlResponse(seen.seq, error=Error("invalid_input", answer, "", False))
        raise Unavailable("The service cannot be reached.")


def chunk(actions: Any) -> Chunk:
    actions.flags.writeable = False  # as those that a client decodes
    return SimpleNamespace(actions=actions, state=b"", valid_until_ns=time.monotonic_ns() + HORIZON_NS)  # type: ignore[return-value]


async def test_a_hold_its_reasons_and_its_end_are_logged_once_each(caplog: pytest.LogCaptureFixture) -> None:
    robot = OwnRobot()
    dirty = "A lens is dirty."
    policy = Policy((None, None), (3, None, None, None, None, *9 * (dirty,)), (0,))

    with caplog.at_level(logging.INFO):
        await robot_controller.Controller(robot, policy, Goal(text="push")).run()

    told = [re.sub(r"\d+", "N", record.getMessage()) for record in caplog.records]
    assert told == [
        "step N: holds: no actions have come yet",
        "step N: holds: The service cannot be reached.",
        "step N: goes on; it held for N steps",
        f"step N: holds: {robot_controller._OVER}",
        "step N: holds: A lens is dirty.",
        "step N: holds: The service cannot be reached.",
    ]
    assert len(robot.executed) > len(told)  # by how many, the machine decides


async def test_actions_of_a_late_chunk_are_executed_at_their_own_control_steps() -> None:
    robot, begun = OwnRobot(), list[int]()

    async def control(requests: AsyncIterator[ControlRequest]) -> AsyncIterator[ControlResponse]:
        await anext(requests)
        seen = [(await anext(requests)).observed for _ in range(4)]
        begun.extend(each.seq for each in seen if each)
        yield ControlResponse(begun[0], chunk=chunk(np.arange(1.0, 9.0, dtype=np.float32)[:, None].repeat(2, axis=1)))
        while not any(action.any() for action in robot.executed):
            await anext(requests)
        yield ControlResponse(begun[0], chunk=chunk(np.zeros((0, 2), np.float32)))

    await robot_controller.Controller(robot, SimpleNamespace(control=control), Goal(text="push")).run()  # type: ignore[arg-type]
    step = next(step for step, action in enumerate(robot.executed) if action.any())
    assert step >= begun[-1] > begun[0]
    assert robot.executed[step].tolist() == [0.5 * (step - begun[0] + 1)] * 2
