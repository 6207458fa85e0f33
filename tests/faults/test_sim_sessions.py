"""Faults of the sim service, over gRPC to a real process."""

import asyncio
import base64
import hashlib
import json
import secrets
import struct
import time
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import numpy as np
import psutil
import pytest
from tests.child_processes import children_running

from freerein.clients import Channel, SimClient, SyncClient
from freerein.errors import InvalidInput
from freerein.types.sim import (
    CloseSessionRequest,
    CreateSessionRequest,
    RenderRequest,
    ResetRequest,
    RestoreRequest,
    SnapshotRequest,
    StepRequest,
)

pytestmark = pytest.mark.e2e

RIGHT = np.array([[3]], np.int64)
WAITING = 20
POOL = 6  # threads of a pool that was not full yet


@pytest.fixture(scope="module")
def service(start_module_service: Callable[..., Any]) -> Any:
    return start_module_service("freerein_sim", FREEREIN_SIM_SESSIONS="4", FREEREIN_SIM_WORKERS="2").until_ready()


@pytest.fixture
def sim(service: Any) -> Iterator[Any]:
    with SyncClient(SimClient(Channel(service.address))) as client:
        yield client


@pytest.fixture
def session(sim: Any) -> Iterator[str]:
    created = sim.create_session(CreateSessionRequest("grid", seed=5))
    sim.reset(ResetRequest(created.session))
    yield created.session
    sim.close_session(CloseSessionRequest(created.session))


@pytest.mark.fault("C14")
@pytest.mark.parametrize("call", ["reset", "step", "render", "snapshot", "restore", "check", "expert-actions"])
def test_a_guessed_id_is_answered_like_that_of_a_session_that_was(sim: Any, service: Any, call: str) -> None:
    closed = sim.create_session(CreateSessionRequest("grid")).session
    sim.close_session(CloseSessionRequest(closed))
    expired = sim.create_session(CreateSessionRequest("grid", lease_s=1e-6)).session
    actions = {"datatype": "INT64", "shape": [1, 1], "raw": base64.b64encode(bytes(8)).decode()}
    states = {"datatype": "FP64", "shape": [1, 1, 12], "raw": base64.b64encode(bytes(96)).decode()}
    parts = {"step": {"step_id": 1, "actions": actions}, "check": {"predicate": "at-landmark", "states": states}}
    answers = set()
    with httpx.Client(base_url=service.url, timeout=60, trust_env=False, verify=False) as rest:
        for session in (closed, expired, secrets.token_hex(16), closed.upper(), "", "../" + closed):
            reply = rest.post(f"/v1/{call}", json={"session": session, **parts.get(call, {})})
            problem = reply.json()
            assert problem.pop("request_id")
            answers.add((reply.status_code, json.dumps(problem)))
    ((status, problem),) = answers
    assert (status, json.loads(problem)["code"]) == (404, "session_not_found")


@pytest.mark.fault("M9")
async def test_calls_that_are_cancelled_while_they_wait_cost_nothing(service: Any, wait_until: Any) -> None:
    async with SimClient(Channel(service.address)) as client:
        session = (await client.create_session(CreateSessionRequest("blocks", num_envs=64, seed=1))).session
        await client.reset(ResetRequest(session))
        render = RenderRequest(session, ("front",))
        workers = children_running("freerein_sim.workers", service.process.pid)
        ratios = []
        while len(ratios) < 10 and min(ratios, default=5) >= 5:  # a busy machine only adds to them
            begun = time.perf_counter()
            await client.render(render)
            one_s = time.perf_counter() - begun
            for worker in workers:
                worker.suspend()
            calls = [asyncio.create_task(client.render(render)) for _ in range(WAITING)]
            await asyncio.to_thread(wait_until, lambda: service.in_flight("grpc") == WAITING, 60)
            for call in calls:
                call.cancel()
            await asyncio.to_thread(wait_until, lambda: service.in_flight("grpc") == 0, 60)
            begun = time.perf_counter()
            for worker in workers:
                worker.resume()
            await client.snapshot(SnapshotRequest(session))
            ratios.append((time.perf_counter() - begun) / one_s)
        await client.close_session(CloseSessionRequest(session))
    assert min(ratios) < 5, ratios


@pytest.mark.fault("G3")
def test_sessions_that_were_closed_leave_nothing_behind(sim: Any, service: Any, fuzz: bool) -> None:
    processes = [psutil.Process(service.process.pid), *children_running("freerein_sim.workers", service.process.pid)]

    def cycle(count: int) -> list[int]:
        """Opens and closes sessions; returns the memory of each process, in bytes."""
        for seed in range(count):
            session = sim.create_session(CreateSessionRequest("grid", num_envs=4, seed=seed)).session
            sim.reset(ResetRequest(session))
            sim.close_session(CloseSessionRequest(session))
        return [process.memory_info().rss for process in processes]

    before = cycle(50)
    files, threads = ([process.num_fds() for process in processes], [process.num_threads() for process in processes])
    after = cycle(10_000 if fuzz else 50)
    assert [process.num_fds() for process in processes] == files
    assert all(process.num_threads() <= then + POOL for process, then in zip(processes, threads, strict=True))
    assert children_running("freerein_sim.workers", service.process.pid) == processes[1:]
    assert all(now < 1.05 * then for now, then in zip(after, before, strict=True)), (before, after)


@pytest.mark.fault("F1")
def test_a_forged_snapshot_is_refused_and_harms_no_session(sim: Any, service: Any, session: str) -> None:
    workers = children_running("freerein_sim.workers", service.process.pid)
    others = [sim.create_session(CreateSessionRequest("grid", seed=i)).session for i in range(2)]  # on both workers
    for each in others:
        sim.reset(ResetRequest(each))
    kept = sim.snapshot(SnapshotRequest(session)).snapshot
    (length,) = struct.unpack_from("<I", kept, 32)
    header, envs = kept[36 : 36 + length], kept[36 + length :]
    true_step = json.dumps(json.loads(header) | {"step_id": True}).encode()
    for forged in (true_step, b"[" * 200_000, b"[" * 4000):
        body = struct.pack("<I", len(forged)) + forged + envs
        with pytest.raises(InvalidInput) as refused:
            sim.restore(RestoreRequest(session, hashlib.sha256(body).digest() + body))
        assert refused.value.field == "snapshot"
    for each in (session, *others):
        assert sim.step(StepRequest(each, 1, RIGHT)).step_id == 1
    assert children_running("freerein_sim.workers", service.process.pid) == workers
    for each in others:
        sim.close_session(CloseSessionRequest(each))
