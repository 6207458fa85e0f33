"""A stream on which nothing is said for long stays open, though its client asks whether anybody is there."""

from collections.abc import Callable
from typing import Any

import grpc
import pytest
from grpc_health.v1 import health_pb2, health_pb2_grpc

pytestmark = pytest.mark.e2e

_EAGER = [("grpc.keepalive_time_ms", 1_000), ("grpc.http2.max_pings_without_data", 0)]


def test_a_quiet_stream_outlasts_its_clients_pings(start_service: Callable[..., Any]) -> None:
    service = start_service("freerein_sim", FREEREIN_SIM_WORKERS="1")
    with grpc.insecure_channel(service.address, _EAGER) as channel:
        changes = health_pb2_grpc.HealthStub(channel).Watch(health_pb2.HealthCheckRequest(), timeout=6)
        with pytest.raises(grpc.RpcError) as ended:
            list(changes)

    assert ended.value.code() is grpc.StatusCode.DEADLINE_EXCEEDED  # of the call, and no UNAVAILABLE before it
