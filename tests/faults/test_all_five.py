"""All five services as `freerein up` runs them, stopped under load and killed: no accepted call is lost.

`test_lifecycle.py` proves the same of one service, `test_kill_matrix.py` of a run whose services are killed at once.
"""

import asyncio
import os
import re
import signal
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack, aclosing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import grpc
import httpx
import numpy as np
import pytest
import pytest_asyncio
from tests.faults import control_robot as robots

from freerein.clients import (
    Channel,
    ImitationClient,
    OrchestratorClient,
    RewardClient,
    SegmentationClient,
    SimClient,
)
from freerein.clients.rpc import Client
from freerein.errors import Unavailable
from freerein.stack import RestartPolicy, ServiceStatus, Stack
from freerein.types.orchestrator import GetRunRequest, StartRunRequest, WatchRunRequest, WatchRunResponse
from freerein.types.reward import RewardRequest
from freerein.types.segmentation import SegmentRequest
from freerein.types.sim import DemonstrateRequest

pytestmark = [pytest.mark.e2e, pytest.mark.long, pytest.mark.asyncio(loop_scope="module")]
HERE = Path(__file__).parent
MODULES = {
    "sim": "freerein_sim",
    "segmentation": "faulty_service",
    "imitation": "faulty_policy",
    "reward": "faulty_reward",
    "orchestrator": "freerein_orchestrator",
}
RECOVERY_S = 30.0  # 3 s on an idle machine
IN_FLIGHT = re.compile(r'^freerein_calls_in_flight\{protocol="grpc"\} (\S+)$', re.MULTILINE)
_PATIENT = RestartPolicy(longest_delay_s=0.5, crashes=1000)  # every kill is the first


@pytest_asyncio.fixture(loop_scope="module", scope="module")
async def stack(tmp_path_factory: pytest.TempPathFactory, reserve_ports: Any) -> AsyncIterator[Stack]:
    """The five services, with toy models that load at once and answer as slowly as asked."""
    mine = {
        "PYTHONPATH": os.pathsep.join(filter(None, (str(HERE), os.environ.get("PYTHONPATH")))),
        "FREEREIN_SHIPPED_DIR": "none",
        "FREEREIN_SIM_WORKERS": "1",
        "OMP_NUM_THREADS": "1",
    }
    data_dir, ports = tmp_path_factory.mktemp("five"), reserve_ports(MODULES)
    (data_dir / "lies").write_text("slow 1000000")
    async with Stack(
        MODULES, data_dir=data_dir, environ={**os.environ, **mine, "OMP_NUM_THREADS": "1"}, ports=ports, policy=_PATIENT
    ) as stack:
        await stack.ready(timeout_s=300)
        yield stack
    logs = "".join(path.read_text() for path in (data_dir / "logs").iterdir())
    assert not [bug for bug in ('"event": "bug"', "Traceback", "never retrieved") if bug in logs]


# --- one slow, deterministic call for each service


async def trajectories(sim: Any) -> Any:
    request = DemonstrateRequest("blocks", "random", count=1, seed=5, height=16, width=16)
    return [each.trajectory.frames["front"].tobytes() async for each in sim.demonstrate(request)]


async def labels(segmentation: Any) -> Any:
    frames = np.zeros((3, 4, 4, 3), np.uint8)
    frames[:, 0, 0, 2], frames[0, 0, 0, 1] = (0, 1, 0), 10
    return list((await segmentation.segment(SegmentRequest(frames=frames))).labels)


async def acts(imitation: Any) -> Any:
    request = robots.asked(5, 100)
    slow = robots.picture(5, hundredths=10)
    request = type(request)(type(request.observation)((slow,)), request.goal)
    return (await imitation.act(request)).actions.round(3).tolist()  # in a batch with others the last bits may differ


async def rewards(reward: Any) -> Any:
    frames = np.random.default_rng(0).integers(0, 255, (4, 8, 8, 3), np.uint8)
    return (await reward.reward(RewardRequest("more", {"top": frames}, mode="raw"))).rewards.round(3).tolist()


COLLECT = StartRunRequest("collect", {"task": "grid", "dataset": "once", "behaviour": "random", "count": 1}, "once")


async def run_id(orchestrator: Any) -> Any:
    return (await orchestrator.start_run(COLLECT)).run.id


@dataclass(frozen=True)
class Probe:
    """A service and a call to it."""

    status: Callable[[], ServiceStatus]
    client: Client
    call: Callable[[Any], Awaitable[Any]]

    async def ask(self) -> Any:
        return await self.call(self.client)

    async def ask_with_retries(self) -> Any:
        """Retries until there is a reply, as clients do for idempotent calls."""
        while True:
            try:
                return await self.ask()
            except Unavailable:
                await asyncio.sleep(0.1)


@pytest_asyncio.fixture(loop_scope="module")
async def probes(stack: Stack) -> AsyncIterator[dict[str, Probe]]:
    known: dict[str, tuple[Any, Callable[[Any], Awaitable[Any]]]] = {
        "sim": (SimClient, trajectories),
        "segmentation": (SegmentationClient, labels),
        "imitation": (ImitationClient, acts),
        "reward": (RewardClient, rewards),
        "orchestrator": (OrchestratorClient, run_id),
    }
    async with AsyncExitStack() as clients:
        opened = {}
        for index, (name, (client, call)) in enumerate(known.items()):
            connected = await clients.enter_async_context(client(Channel(stack.addresses[name])))
            opened[name] = Probe(lambda index=index: stack.statuses[index], connected, call)  # type: ignore[misc]
        yield opened


async def until(stack: Stack, holds: Callable[[], bool], within_s: float) -> float:
    """Waits until a condition holds; returns the seconds it took."""
    begun = time.monotonic()
    async with asyncio.timeout(within_s), aclosing(stack.watch()) as changes:
        async for _ in changes:
            if holds():
                break
    return time.monotonic() - begun


# --- SIGTERM


@pytest.mark.fault("C18")
@pytest.mark.fault("G7")
@pytest.mark.parametrize("name", list(MODULES)[:4])
async def test_on_sigterm_a_service_answers_accepted_calls_and_refuses_new_ones(
    stack: Stack, probes: dict[str, Probe], repeats: int, name: str
) -> None:
    one = probes[name]
    expected = await one.ask()

    async def stopped() -> float:
        """Returns the seconds until the service ended."""
        accepted = await in_flight(stack.urls[name], one, 4)
        begun = time.monotonic()
        os.kill(one.status().pid, signal.SIGTERM)
        await refused(stack, name)
        assert await asyncio.gather(*accepted) == [expected] * 4
        await ended(stack, one)
        seconds = time.monotonic() - begun
        await until(stack, lambda: one.status().state == "ready", 300)
        assert await one.ask() == expected
        return seconds

    for _ in range(repeats):
        await within(RECOVERY_S, stopped)


async def ended(stack: Stack, one: Probe) -> None:
    """Waits until a service that was told to stop has exited with code 0."""
    await until(stack, lambda: one.status().state == "restarting", 300)
    assert one.status().reason == "It exited with code 0."


async def within(seconds: float, measure: Callable[[], Awaitable[float]]) -> None:
    """Fails unless a measurement is below a number of seconds once in three tries: a busy machine only adds to it."""
    taken = [await measure()]
    while taken[-1] >= seconds and len(taken) < 3:
        taken.append(await measure())
    assert min(taken) < seconds


async def in_flight(url: str, one: Probe, calls: int) -> list[asyncio.Task[Any]]:
    """Returns calls that a service's metrics tell to be in flight at once; those answered before are asked again."""
    async with httpx.AsyncClient(base_url=url, timeout=60, trust_env=False) as client, asyncio.timeout(300):
        while True:
            asked = [asyncio.create_task(one.ask()) for _ in range(calls)]
            while not all(task.done() for task in asked):
                found = IN_FLIGHT.search((await client.get("/metrics")).text)
                if found is not None and float(found[1]) >= calls:
                    return asked
            await asyncio.gather(*asked)


async def refused(stack: Stack, name: str) -> None:
    """Waits until a service refuses calls over REST and gRPC."""
    async with httpx.AsyncClient(base_url=stack.urls[name], timeout=60, trust_env=False) as client:
        answers = True
        while answers:
            try:
                answers = (await client.get("/readyz")).status_code == 200
            except httpx.TransportError:
                answers = False
    code = None
    async with grpc.aio.insecure_channel(stack.addresses[name]) as late:
        while code is not grpc.StatusCode.UNAVAILABLE:  # for a moment, calls may have been sent before
            with pytest.raises(grpc.aio.AioRpcError) as error:
                await late.unary_unary("/freerein.api.any.v1.AnyService/Any")(b"", timeout=60)
            code = error.value.code()
            assert code in (grpc.StatusCode.UNAVAILABLE, grpc.StatusCode.UNIMPLEMENTED)


@pytest.mark.fault("C18")
async def test_on_sigterm_the_orchestrator_ends_streams_and_its_run_resumes_at_the_next_start(
    stack: Stack, probes: dict[str, Probe]
) -> None:
    one = probes["orchestrator"]
    client: Any = one.client
    config = {"task": "blocks", "dataset": "long", "behaviour": "random", "count": 20, "height": 16, "width": 16}
    run = (await client.start_run(StartRunRequest("collect", config, "long"))).run
    events: list[WatchRunResponse] = []
    begins = asyncio.Event()

    async def watch() -> None:
        async with aclosing(client.watch_run(WatchRunRequest(run.id, len(events)))) as watching:
            async for event in watching:
                events.append(event)
                if event.run.step:
                    begins.set()

    watching = asyncio.create_task(watch())
    await begins.wait()
    begun = time.monotonic()
    os.kill(one.status().pid, signal.SIGTERM)
    await refused(stack, "orchestrator")
    await watching
    assert time.monotonic() - begun < RECOVERY_S
    assert events[-1].run.state == "running"
    await ended(stack, one)
    assert time.monotonic() - begun < 2 * RECOVERY_S
    await until(stack, lambda: one.status().state == "ready", 300)
    while events[-1].run.state == "running":
        await watch()
    assert events[-1].run.state == "succeeded"
    assert [event.sequence for event in events] == list(range(len(events)))
    steps = [event.run.step for event in events]
    assert steps == sorted(steps)


# --- SIGKILL


@pytest.mark.fault("C19")
@pytest.mark.fault("G6")
@pytest.mark.parametrize("name", MODULES)
async def test_a_killed_service_is_soon_back_and_retries_succeed(
    stack: Stack, probes: dict[str, Probe], repeats: int, name: str
) -> None:
    one = probes[name]
    others = [other for other in probes if other != name]
    expected = {each: await probes[each].ask() for each in probes}

    async def killed() -> float:
        """Returns the seconds that the service was unavailable."""
        pids = {each: probes[each].status().pid for each in probes}
        asking = asyncio.create_task(one.ask_with_retries())
        os.kill(pids[name], signal.SIGKILL)
        assert [await probes[each].ask() for each in others] == [expected[each] for each in others]
        seconds = await until(stack, lambda: one.status().pid not in (0, pids[name]), 300)
        seconds += await until(stack, lambda: one.status().state == "ready", 300)
        assert await asking == expected[name]
        assert [probes[each].status().pid for each in others] == [pids[each] for each in others]
        return seconds

    for _ in range(repeats):
        await within(RECOVERY_S, killed)


@pytest.mark.long  # short, of the services that a run calls: test_kill_matrix.py
@pytest.mark.fault("O15")
async def test_an_acknowledged_run_succeeds_though_all_five_services_are_killed_at_once(
    stack: Stack, probes: dict[str, Probe]
) -> None:
    client: Any = probes["orchestrator"].client
    config = {"task": "grid", "dataset": "acknowledged", "behaviour": "random", "count": 3}
    run = (await client.start_run(StartRunRequest("collect", config, "acknowledged"))).run
    killed = {name: one.status().pid for name, one in probes.items()}
    for pid in killed.values():
        os.kill(pid, signal.SIGKILL)
    await until(stack, lambda: all(one.status().pid not in (0, killed[name]) for name, one in probes.items()), 300)
    await stack.ready(timeout_s=300)
    while run.state in ("queued", "running"):
        await asyncio.sleep(0.1)
        run = (await client.get_run(GetRunRequest(run.id))).run
    assert (run.state, run.step) == ("succeeded", 3)
