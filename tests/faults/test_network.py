"""A bad network: what comes through it is right and happened once; what does not is an error of the protocol."""

import asyncio
import itertools
import random
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import aclosing
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pytest
from tests.faults import chaos_proxy as network
from tests.faults import control_robot as robots
from tests.faults import faulty_policy as policies

from freerein.clients import Channel, ImitationClient, OrchestratorClient, RewardClient, SimClient
from freerein.errors import DeadlineExceeded, Unavailable
from freerein.types.orchestrator import ListRunsRequest, StartRunRequest, WatchRunRequest, WatchRunResponse
from freerein.types.reward import RewardRequest
from freerein.types.sim import (
    CloseSessionRequest,
    CreateSessionRequest,
    ListTasksRequest,
    ResetRequest,
    SnapshotRequest,
    StepRequest,
)

pytestmark = [pytest.mark.e2e, pytest.mark.fault("N1")]
TOY_REWARD = "tests.reward.toy_service"
BROKEN = (Unavailable, DeadlineExceeded)  # all that a network may do to a call
WEATHERS = {
    "late": {"delay_s": 0.05, "jitter_s": 0.02},
    "thin": {"bytes_per_s": 125_000},  # 1 Mbit/s
    "split": {"segment": 1},
    "broken": {"resets_after": 20_000},
}
T = TypeVar("T")


async def insist(call: Callable[[], Awaitable[T]]) -> T:
    """Makes a call again until it is answered."""
    while True:
        try:
            return await call()
        except BROKEN:
            await asyncio.sleep(0.01)


@pytest.fixture(scope="module")
def sim(start_module_service: Callable[..., Any]) -> Any:
    return start_module_service("freerein_sim", FREEREIN_SIM_WORKERS="2")


@pytest.fixture
async def direct(sim: Any) -> AsyncIterator[SimClient]:
    async with SimClient(Channel(sim.address)) as client:
        await insist(lambda: client.list_tasks(ListTasksRequest()))
        yield client


class Episode:
    """A session that random actions are taken in: always the same ones.

    Attributes:
        seen: What it has shown, step by step.
    """

    def __init__(self, client: SimClient, key: str) -> None:
        self.seen: list[bytes] = []
        self._client = client
        self._key = key
        self._session = ""
        self._rng = np.random.default_rng(1)

    async def steps(self, count: int, *, timeout_s: float = 30.0) -> list[bytes]:
        """Takes more steps; returns all that was shown so far, and where the session stands."""
        if not self._session:
            request = CreateSessionRequest("grid", num_envs=2, seed=7, idempotency_key=self._key)
            self._session = (await insist(lambda: self._client.create_session(request))).session
            await insist(lambda: self._client.reset(ResetRequest(self._session, seed=3), timeout_s=timeout_s))
        for _ in range(count):
            actions = self._rng.integers(0, 4, (2, 1))
            step = StepRequest(self._session, len(self.seen) + 1, actions, ("top",))
            reply = await insist(lambda step=step: self._client.step(step, timeout_s=timeout_s))
            self.seen.append(reply.frames["top"].tobytes())
        stands = await insist(lambda: self._client.snapshot(SnapshotRequest(self._session), timeout_s=timeout_s))
        return [*self.seen, stands.snapshot]

    async def close(self) -> None:
        await insist(lambda: self._client.close_session(CloseSessionRequest(self._session)))


@pytest.mark.parametrize("name", WEATHERS)
async def test_every_step_is_taken_once_and_shows_the_same_bits(
    sim: Any, direct: SimClient, fuzz: bool, name: str
) -> None:
    steps = 300 if fuzz else 10
    undisturbed = Episode(direct, f"undisturbed-{name}")
    async with (
        network.ChaosProxy(sim.address, network.Weather(**WEATHERS[name])) as proxy,
        SimClient(Channel(proxy.address)) as client,
    ):
        disturbed = Episode(client, name)
        assert await disturbed.steps(steps) == await undisturbed.steps(steps)
        assert (proxy.connections > 1) == (name == "broken")
        await disturbed.close()
    await undisturbed.close()


async def test_a_connection_that_breaks_stalls_or_half_closes_at_any_moment_costs_nothing_but_time(
    sim: Any, direct: SimClient, fuzz: bool
) -> None:
    rng, undisturbed = random.Random(1), Episode(direct, "undisturbed")
    async with (
        network.ChaosProxy(sim.address, network.Weather(delay_s=0.002, jitter_s=0.002)) as proxy,
        SimClient(Channel(proxy.address)) as client,
    ):
        disturbed = Episode(client, "disturbed")
        await disturbed.steps(1)
        for breaks in [proxy.reset, proxy.half_close, proxy.refuse, proxy.partition] * (25 if fuzz else 1):
            stepping = asyncio.create_task(disturbed.steps(20, timeout_s=0.2))
            await asyncio.sleep(rng.uniform(0, 0.1))
            breaks()
            await asyncio.sleep(0.3)
            proxy.heal()
            seen = await stepping
        assert seen == await undisturbed.steps(len(disturbed.seen))
        await disturbed.close()
    await undisturbed.close()


async def test_a_partition_heals_without_anybody_and_peers_never_notice(
    sim: Any, direct: SimClient, fuzz: bool
) -> None:
    peer = Episode(direct, "peer")
    async with network.ChaosProxy(sim.address) as proxy, SimClient(Channel(proxy.address)) as client:
        cut_off = Episode(client, "cut-off")
        await cut_off.steps(5)
        proxy.partition()
        waiting = asyncio.create_task(cut_off.steps(45))
        await peer.steps(50)
        await asyncio.sleep(30 if fuzz else 1)
        assert len(cut_off.seen) == 5
        proxy.heal()
        assert await asyncio.wait_for(waiting, 60) == await peer.steps(0)
        await cut_off.close()
    await peer.close()


async def test_a_reply_that_takes_seconds_on_a_thin_line_arrives(sim: Any, direct: SimClient) -> None:
    request = CreateSessionRequest("blocks", num_envs=16, seed=7)
    shown = []
    async with (
        network.ChaosProxy(sim.address, network.Weather(**WEATHERS["thin"])) as proxy,
        SimClient(Channel(proxy.address)) as client,
    ):
        for each in (client, direct):
            session = (await each.create_session(request)).session
            shown.append((await each.reset(ResetRequest(session, cameras=("front",)))).frames["front"].tobytes())
            await each.close_session(CloseSessionRequest(session))
        assert proxy.connections == 1
    assert shown[0] == shown[1]


async def test_rewards_are_those_of_an_undisturbed_call(start_service: Callable[..., Any]) -> None:
    service = start_service(TOY_REWARD, FREEREIN_SHIPPED_DIR="none")
    frames = np.random.default_rng(0).integers(0, 255, (16, 32, 32, 3), np.uint8)
    request = RewardRequest("more", {"top": frames}, mode="raw")
    async with RewardClient(Channel(service.address)) as client:
        expected = (await insist(lambda: client.reward(request))).rewards
    for weather in ({"bytes_per_s": 125_000}, {"delay_s": 0.05, "jitter_s": 0.05}):
        async with (
            network.ChaosProxy(service.address, network.Weather(**weather)) as proxy,
            RewardClient(Channel(proxy.address)) as client,
        ):
            asking = asyncio.create_task(insist(lambda client=client: client.reward(request)))
            for _ in range(3):
                await asyncio.sleep(0.05)
                proxy.reset()
            np.testing.assert_array_equal((await asking).rewards, expected)


async def test_a_robot_whose_streams_break_gets_every_action_that_it_would_have_got(
    start_faulty: Callable[..., Any], tmp_path: Path, repeats: int
) -> None:
    faulty = start_faulty(tmp_path, module="tests.faults.faulty_policy")
    oracle = await robots.Oracle.of(policies.FaultyPolicy(policies.SEEDS[0]), 200, 201)
    rng, state, did = random.Random(2), b"", None
    async with (
        network.ChaosProxy(faulty.service.address, network.Weather(delay_s=0.005, jitter_s=0.005)) as proxy,
        ImitationClient(Channel(proxy.address)) as client,
    ):
        seq = 0
        for _ in range(4 * repeats):
            proxy.weather = network.Weather(segment=rng.choice((0, 1, 7)), resets_after=rng.randrange(300, 3_000))
            stream = robots.Stream(client.control)
            try:
                await stream.ask(robots.hello(200, 201, state=state))
                while True:
                    request = robots.seen(seq, seq % 100, did=did)
                    reply = await stream.ask(request)
                    await oracle.check(request, reply)
                    state, did, seq = reply.chunk.state, reply.chunk.actions[0], seq + 1
            except Unavailable:
                await stream.leave()
        assert seq > 4 * repeats
        request = robots.asked(seq % 100, 200, 201, did=did, state=state)
        expected = await oracle.answer(robots.seen(seq, seq % 100, did=did))
        answer = await insist(lambda: client.act(request))
        np.testing.assert_allclose(answer.actions, expected.actions, rtol=0, atol=1e-5)


async def test_a_run_that_is_watched_over_it_loses_no_event_and_repeats_none(
    sim: Any, start_service: Callable[..., Any]
) -> None:
    service = start_service("freerein_orchestrator", FREEREIN_SIM_ADDRESS=sim.address)
    config = {"task": "grid", "dataset": "watched", "behaviour": "random", "count": 10}
    async with (
        OrchestratorClient(Channel(service.address)) as direct,
        network.ChaosProxy(service.address) as proxy,
        OrchestratorClient(Channel(proxy.address)) as client,
    ):
        request = StartRunRequest("collect", config, "watched")
        run = (await insist(lambda: client.start_run(request))).run
        events: list[WatchRunResponse] = []
        breaks = itertools.count(300, 100)  # later each time: in every part of an event, and in the end there is none
        while not events or events[-1].run.state != "succeeded":
            proxy.reset()
            proxy.weather = network.Weather(segment=50, resets_after=next(breaks))
            try:
                async with aclosing(client.watch_run(WatchRunRequest(run.id, len(events)))) as watching:
                    async for event in watching:
                        events.append(event)
            except BROKEN:
                continue
        async with aclosing(direct.watch_run(WatchRunRequest(run.id))) as watching:
            assert events == [event async for event in watching]
        assert proxy.connections > 2
        assert [each.id for each in (await direct.list_runs(ListRunsRequest())).runs] == [run.id]
