"""Control streams above the limit, with another's state, and calls with extreme deadlines."""

import asyncio
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import grpc
import pytest
from tests.faults import control_robot as robots
from tests.faults import faulty_policy as policies

from freerein import wire
from freerein.clients import Channel, ImitationClient
from freerein.errors import DeadlineExceeded, FailedPrecondition, Overloaded
from freerein.serving.grpc_server import GrpcServer
from freerein.serving.health import Health
from freerein.serving.learned import LearnedSettings
from freerein.serving.limits import Limits
from freerein.serving.metrics import Metrics

pytestmark = pytest.mark.e2e
STREAMS = 64
ACT = "/freerein.api.imitation.v1.ImitationService/Act"
IN_FLIGHT = 'freerein_calls_in_flight{protocol="grpc"}'
ITEMS = "freerein_batch_size_sum"  # that the model has computed
TEN_YEARS_S = 10 * 365 * 86400.0


@pytest.fixture(scope="module")
def data_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("policies")


@pytest.fixture(scope="module")
def faulty(start_faulty: Callable[..., Any], data_dir: Path) -> Any:
    faulty = start_faulty(data_dir, module="tests.faults.faulty_policy")
    faulty.service.until_ready()
    return faulty


@pytest.fixture
async def client(faulty: Any) -> AsyncIterator[ImitationClient]:
    async with ImitationClient(Channel(faulty.service.address)) as client:
        yield client


@pytest.mark.fault("I12")
async def test_a_stream_above_the_limit_is_refused_at_once_and_the_others_go_on(client: Any) -> None:
    streams = [robots.Stream(client.control) for _ in range(STREAMS)]
    await asyncio.gather(*(stream.ask(robots.hello()) for stream in streams))
    for seq in range(3):
        with pytest.raises(Overloaded, match=f"At most {STREAMS} streams") as refused:
            await robots.Stream(client.control).hear()  # at its opening, before a Hello
        assert refused.value.retry_after_s
        replies = await asyncio.gather(*(stream.ask(robots.seen(seq)) for stream in streams))
        assert all(reply.chunk is not None for reply in replies)
    await streams.pop().rest()
    streams.append(robots.Stream(client.control))
    assert (await streams[-1].ask(robots.hello())).spec is not None
    await asyncio.gather(*(stream.rest() for stream in streams))


@pytest.mark.fault("I11")
async def test_a_state_of_another_goal_or_model_is_refused(client: Any, data_dir: Path) -> None:
    stream = robots.Stream(client.control)
    await stream.ask(robots.hello(200))
    state = (await stream.ask(robots.seen(0))).chunk.state
    other = policies.publish_policies(data_dir)[1]
    for hello in (robots.hello(201, state=state), robots.hello(200, state=state, model=other)):
        with pytest.raises(FailedPrecondition):
            await robots.Stream(client.control).ask(hello)
    assert (await stream.ask(robots.seen(1))).chunk is not None
    await stream.rest()


@pytest.mark.fault("I17")
async def test_work_whose_deadline_passed_in_the_queue_is_not_done(client: Any, faulty: Any, wait_until: Any) -> None:
    done = faulty.metric(ITEMS)
    held = asyncio.create_task(client.act(_asked(fault="held")))
    with await asyncio.to_thread(faulty.hold):
        timeouts_s = (0.001, 0.02, 0.05, 0.1) * 5
        expired = [client.act(robots.asked(1, 200), timeout_s=timeout_s) for timeout_s in timeouts_s]
        outcomes = await asyncio.gather(*expired, return_exceptions=True)
        assert {type(outcome) for outcome in outcomes} == {DeadlineExceeded}
        await asyncio.to_thread(wait_until, lambda: faulty.metric(IN_FLIGHT) == 1, 60)  # the service knows it, too
    assert (await held).actions.size
    assert (await client.act(robots.asked(1, 200))).actions.size
    assert faulty.metric(ITEMS) == done + 2


def _asked(**asked: Any) -> Any:
    request = robots.asked(1, 200)
    return type(request)(
        type(request.observation)((robots.picture(1, **asked),)), request.goal, request.executed_actions
    )


@pytest.mark.fault("I17")
@pytest.mark.parametrize("timeout_s", [None, TEN_YEARS_S])
async def test_a_call_with_no_deadline_or_a_distant_one_gets_the_service_s_own(
    tmp_path: Path, timeout_s: float | None
) -> None:
    health, metrics, limits = Health(), Metrics(), Limits(unary_s=0.3)
    service = policies.build_faulty(LearnedSettings(data_dir=tmp_path, shipped_dir=tmp_path), limits, metrics, health)
    await service.start()
    server = GrpcServer(service.methods, health=health, metrics=metrics, limits=limits).server
    port = server.add_insecure_port("127.0.0.1:0")
    await server.start()
    request = wire.pack(_asked(hundredths=150)).SerializeToString()
    async with grpc.aio.insecure_channel(f"127.0.0.1:{port}") as channel:
        with pytest.raises(grpc.aio.AioRpcError) as ended:
            await channel.unary_unary(ACT)(request, timeout=timeout_s)
    assert ended.value.code() is grpc.StatusCode.DEADLINE_EXCEEDED
    await server.stop(None)
    health.drain()
    await service.close()
