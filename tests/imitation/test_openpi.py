"""A robot with openpi's client holds where its goal is over: by no motion, or at its last target."""

from collections.abc import AsyncIterator, Callable
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from freerein.errors import FailedPrecondition
from freerein.serving.batcher import Batcher
from freerein.serving.metrics import Metrics
from freerein.types.common import ModelRef
from freerein_imitation.core import PolicyRunner
from freerein_imitation.openpi.messages import pack, unpack
from freerein_imitation.openpi.service import OpenpiConnection, OpenpiQuery

GOAL = 6
Ask = Callable[..., Any]


@pytest.fixture
async def connect(policies: Any) -> AsyncIterator[Callable[[bool], Ask]]:
    """Returns how a robot asks for actions; its actions are targets, or changes."""
    batcher = Batcher(PolicyRunner().run_batch, queue=8, batch=8, metrics=Metrics())

    def make(absolute: bool) -> Ask:
        policy = policies.FaultyPolicy(7)
        policy.spec = replace(policy.spec, action=replace(policy.spec.action, absolute=absolute))
        query = OpenpiQuery(ModelRef(), None, 100, 0)
        connection = OpenpiConnection(ModelRef("targets", "1"), policy, query, batcher, timeout_s=30.0)

        async def ask(brightness: int, **values: Any) -> Any:
            seen = {"observation/front": frame(brightness), "goal/front": frame(GOAL), **values}
            return unpack(await connection.answer(pack(seen)))["actions"]

        return ask

    yield make
    batcher.close()


def frame(brightness: int) -> npt.NDArray[np.uint8]:
    pixels = np.zeros((4, 4, 3), np.uint8)
    pixels[0, 0, 2] = brightness
    return pixels


async def test_a_robot_of_changes_holds_by_none(connect: Callable[[bool], Ask]) -> None:
    ask = connect(False)
    await ask(0)
    np.testing.assert_array_equal(await ask(GOAL), np.zeros((3, 2)))


async def test_a_robot_of_targets_holds_at_the_last_one(connect: Callable[[bool], Ask]) -> None:
    ask = connect(True)
    proposed = await ask(0)
    np.testing.assert_array_equal(await ask(GOAL), proposed[[-1] * 3])
    np.testing.assert_array_equal(await ask(GOAL), proposed[[-1] * 3])
    clipped = np.array([[0.5, -0.5], [0.25, 0.75]], np.float32)
    np.testing.assert_array_equal(await ask(GOAL, executed_actions=clipped), clipped[[-1] * 3])


async def test_a_robot_of_targets_that_was_told_none_is_not_sent_anywhere(connect: Callable[[bool], Ask]) -> None:
    ask = connect(True)
    await ask(0)
    with pytest.raises(FailedPrecondition, match="must have executed one") as refused:
        await ask(GOAL, reset=True)
    assert refused.value.field == "executed_actions"
