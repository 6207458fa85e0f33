"""The limits that a service has unless told otherwise are those that `docs/protocol.md` states."""

from pathlib import Path

import pytest

from freerein.serving.limits import Limits

PAGE = (Path(__file__).parents[2] / "docs" / "protocol.md").read_text()
MIB = 2**20


@pytest.mark.parametrize(
    ("name", "value", "row"),
    [
        ("message_bytes", 64 * MIB, "| REST body, gRPC message | 64 MiB |"),
        ("buffered_bytes", 512 * MIB, "| 512 MiB | `overloaded` |"),
        ("receipt_s", 10.0, "(`FREEREIN_RECEIPT_S`) | 10 s"),
        ("write_s", 30.0, "(`FREEREIN_WRITE_S`) | 30 s |"),
        ("unary_s", 30.0, "| 30 s, or the caller's shorter deadline |"),
        ("queue", 256, "(`FREEREIN_QUEUE`) | 256 |"),
        ("streams", 64, "| streams open at once, over REST and over gRPC each | 64 |"),
    ],
)
def test_a_default_is_the_stated_one(name: str, value: float, row: str) -> None:
    assert getattr(Limits(), name) == value
    assert row in PAGE


def test_calls_in_flight_have_time_to_end_before_a_service_must_have_ended() -> None:
    assert "| from SIGTERM to exit | 10 s |" in PAGE
    assert Limits().drain_s == 8.0


def test_more_calls_may_be_in_progress_than_may_wait_for_the_model_with_all_streams_open() -> None:
    limits = Limits()
    assert limits.concurrent_calls == 512 > limits.queue + limits.streams
    assert limits.batch == 32
