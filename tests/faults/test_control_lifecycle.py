"""Control streams while the service is killed, told to stop, or given another model: no robot loses its place."""

import asyncio
import itertools
import json
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.faults import control_robot as robots
from tests.faults import faulty_policy as policies
from tests.waiting import wait_until

from freerein.clients import Channel, ImitationClient, ModelClient
from freerein.errors import FailedPrecondition, Unavailable
from freerein.model_store import ModelStore
from freerein.types.common import ModelRef
from freerein.types.learning import ActivateModelRequest

pytestmark = pytest.mark.e2e
ROBOTS = 40  # more than a batch holds, so that some have to wait


async def until(condition: Callable[[], object]) -> None:
    await asyncio.to_thread(wait_until, condition)


@pytest.mark.fault("I8")
@pytest.mark.fault("G6")
def test_killed_in_the_middle_it_is_noticed_at_once_and_another_goes_on_from_the_last_state(
    start_policy: Any, tmp_path: Path, repeats: int, least_of_many: Any
) -> None:
    oracle = asyncio.run(robots.Oracle.of(policies.FaultyPolicy(policies.SEEDS[0]), 200, 201))
    lives, state = itertools.count(), b""

    async def live() -> float:
        """Returns how long it takes to notice that the service is dead, in seconds."""
        nonlocal state
        life = next(lives)
        faulty = start_policy(tmp_path)
        async with ImitationClient(Channel(faulty.service.address)) as client:
            stream = robots.Stream(client.control)
            spec = (await stream.ask(robots.hello(200, 201, state=state))).spec
            assert spec.model.version == policies.publish_policies(tmp_path)[0].version
            for seq in range(10 * life, 10 * life + 5):
                request = robots.seen(seq, seq % 100, did=(0.5, -0.5))
                reply = await stream.ask(request)
                await oracle.check(request, reply)
                state = reply.chunk.state
            stream.say(robots.seen(10 * life + 5, hundredths=100))  # never answered, and so never executed
            begun = time.monotonic()
            faulty.service.kill()
            with pytest.raises(Unavailable):
                await stream.hear()
            return time.monotonic() - begun

    for _ in range(1 + repeats):
        assert least_of_many(lambda: asyncio.run(live()), below=0.5) < 0.5


@pytest.mark.fault("I16")
async def test_told_to_stop_it_answers_tells_every_robot_and_ends(start_policy: Any, tmp_path: Path) -> None:
    first, second = start_policy(tmp_path / "first"), start_policy(tmp_path / "second")
    policy = policies.FaultyPolicy(policies.SEEDS[0])
    async with (
        ImitationClient(Channel(first.service.address)) as client,
        ImitationClient(Channel(second.service.address)) as other,
    ):
        streams = [robots.Stream(client.control) for _ in range(ROBOTS)]
        oracles = [await robots.Oracle.of(policy, 100 + i) for i in range(ROBOTS)]
        await asyncio.gather(*(stream.ask(robots.hello(100 + i)) for i, stream in enumerate(streams)))
        seen = [robots.seen(1, i, fault="right" if i else "held") for i in range(ROBOTS)]
        streams[0].say(seen[0])
        with await asyncio.to_thread(first.hold):
            for stream, request in zip(streams[1:], seen[1:], strict=True):
                stream.say(request)
            await until(lambda: first.metric("freerein_queued_items") == ROBOTS - 1)
            first.service.process.send_signal(signal.SIGTERM)
            await until(lambda: "draining" in first.service.log.read_text())
        for i, (stream, oracle) in enumerate(zip(streams, oracles, strict=True)):
            reply = await stream.hear()
            await oracle.check(seen[i], reply)
            assert (await stream.hear()).draining.deadline_s > 0
            assert await stream.rest() == []
            elsewhere = robots.Stream(other.control)
            await elsewhere.ask(robots.hello(100 + i, state=reply.chunk.state))
            request = robots.seen(2, i, did=reply.chunk.actions[0])
            await oracle.check(request, await elsewhere.ask(request))
            await elsewhere.leave()
    assert await asyncio.to_thread(first.service.process.wait, 60) == 0


@pytest.mark.fault("I15")
async def test_a_model_swapped_under_traffic_changes_between_batches_and_streams_keep_theirs(
    start_policy: Any, tmp_path: Path, repeats: int
) -> None:
    faulty = start_policy(tmp_path)
    versions = policies.publish_policies(tmp_path)
    oracles = {ref: policies.FaultyPolicy(seed) for ref, seed in zip(versions, policies.SEEDS, strict=True)}
    channel, swapped = Channel(faulty.service.address), asyncio.Event()
    async with ImitationClient(channel) as client, ModelClient(Channel(faulty.service.address)) as models:

        async def swap() -> None:
            for i in range(20 * repeats):
                ref = versions[(i + 1) % 2]
                await models.activate_model(ActivateModelRequest(ref.name, ref.version))
            swapped.set()

        async def call() -> set[ModelRef]:
            answered = set()
            while not swapped.is_set():
                reply = await client.act(robots.asked(5, 100))
                expected = await (await robots.Oracle.of(oracles[reply.model], 100)).answer(robots.seen(0, 5))
                np.testing.assert_allclose(reply.actions, expected.actions, atol=1e-5)
                answered.add(reply.model)
            return answered

        async def follow(robot: int) -> None:
            stream, seq = robots.Stream(client.control), 0
            model = (await stream.ask(robots.hello(100 + robot))).spec.model
            oracle = await robots.Oracle.of(oracles[model], 100 + robot)
            while not swapped.is_set():
                request = robots.seen(seq, seq % 90)
                await oracle.check(request, await stream.ask(request))
                seq += 1

        _, answered, *_ = await asyncio.gather(swap(), call(), *(follow(robot) for robot in range(4)))
        assert answered == set(versions)


@pytest.mark.fault("I15")
async def test_damaged_weights_are_refused_and_the_old_ones_go_on(start_policy: Any, tmp_path: Path) -> None:
    faulty = start_policy(tmp_path)
    active, other = policies.publish_policies(tmp_path)
    weights = ModelStore(tmp_path / "models" / policies.NAME).folder(other) / "weights"
    weights.write_bytes(json.dumps(policies.SEEDS[1] + 1).encode())
    async with ImitationClient(Channel(faulty.service.address)) as client:
        stream = robots.Stream(client.control)
        await stream.ask(robots.hello())
        async with ModelClient(Channel(faulty.service.address)) as models:
            with pytest.raises(FailedPrecondition):
                await models.activate_model(ActivateModelRequest(other.name, other.version))
        assert (await stream.ask(robots.seen(1))).chunk is not None
        assert (await client.act(robots.asked(1, 3))).model == active


async def test_robots_that_vanish_free_their_streams(start_policy: Any, tmp_path: Path) -> None:
    faulty = start_policy(tmp_path)
    for _ in range(2):
        client = ImitationClient(Channel(faulty.service.address))
        streams = [robots.Stream(client.control) for _ in range(64)]
        await asyncio.gather(*(stream.ask(robots.hello()) for stream in streams))
        await client.close()
        await until(lambda: faulty.metric('freerein_calls_in_flight{protocol="grpc"}') == 0)
