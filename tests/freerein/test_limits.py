"""`docs/protocol.md` shows the limits that a service has unless told otherwise; slots bound what they count."""

from pathlib import Path

import pytest

from freerein import images
from freerein.errors import Overloaded
from freerein.serving.limits import MAX_INLINE_BYTES, MAX_VALUES, Limits, Slots
from freerein.serving.rest import middleware

PAGE = (Path(__file__).parents[2] / "docs" / "protocol.md").read_text()
LIMITS = Limits()
MIB = 2**20
GRACE_S = 2  # after the drain, for what is left to close
SHOWN = {
    "REST body, gRPC message": f"{LIMITS.message_bytes / MIB:g} MiB",
    "memory for all requests, replies and messages of WebSockets together, three times their length": (
        f"{LIMITS.buffered_bytes / MIB:g} MiB"
    ),
    "HTTP headers and URL": f"{middleware._MAX_HEADERS} headers, {middleware.MAX_HEADER_BYTES // 1024} KiB together",
    "values in a JSON body, fields and packed numbers in a gRPC message": f"{MAX_VALUES:,}".replace(",", " "),
    "pixels of an image / of all images of a request": (
        f"{images.MAX_PIXELS / 1e6:g} M / {images.MAX_REQUEST_PIXELS / 1e6:g} M"
    ),
    "receiving the first message of a gRPC call (`FREEREIN_RECEIPT_S`)": f"{LIMITS.receipt_s:g} s",
    f"gRPC messages that take longer than {LIMITS.slow_receipt_s:g} s to arrive": (f"{LIMITS.slow_messages}"),
    "gRPC calls in progress / on one connection": f"{LIMITS.concurrent_calls} / {LIMITS.connection_calls}",
    "gRPC health checks in progress / health watches, besides other calls": (
        f"{LIMITS.health_calls} / {LIMITS.health_calls}"
    ),
    "leaving a reply unread (`FREEREIN_WRITE_S`)": f"{LIMITS.write_s:g} s",
    "a unary call (`FREEREIN_UNARY_S`)": f"{LIMITS.unary_s:g} s, or the caller's shorter deadline",
    "items waiting for the model (`FREEREIN_QUEUE`)": f"{LIMITS.queue}",
    "streams open at once, over REST and over gRPC each; robots' WebSockets": f"{LIMITS.streams}",
    "HTTP connection without a request after the first (`FREEREIN_KEEP_ALIVE_S`) / such connections": (
        f"{LIMITS.http_keep_alive_s:g} s / {LIMITS.idle_connections}"
    ),
    "between two pings of a WebSocket / from a ping until anything arrives (`FREEREIN_PING_S`)": (
        f"{LIMITS.ping_s:g} s / {LIMITS.ping_s:g} s"
    ),
    "from SIGTERM, and `FREEREIN_DRAIN_DELAY_S` after it, to exit": f"{LIMITS.drain_s + GRACE_S:g} s",
}


@pytest.mark.parametrize("limit", SHOWN)
def test_the_page_shows_the_limit(limit: str) -> None:
    assert f"| {limit} | {SHOWN[limit]} |" in PAGE


def test_what_the_page_does_not_show() -> None:
    assert LIMITS.concurrent_calls > LIMITS.queue + LIMITS.streams  # streams do not keep calls from the queue
    assert LIMITS.batch == 32
    assert MAX_INLINE_BYTES == 64 * 1024


def test_slots_are_taken_freed_and_bounded() -> None:
    slots = Slots(2, "doors may be open")
    slots.take()
    with slots.hold():
        assert slots.taken == 2
        with pytest.raises(Overloaded, match="At most 2 doors may be open at once"):
            slots.take()
        with pytest.raises(Overloaded), slots.hold():
            pass
        assert slots.taken == 2  # a refusal takes none
    slots.free()
    assert slots.taken == 0
    with pytest.raises(ZeroDivisionError), slots.hold():
        raise ZeroDivisionError
    assert slots.taken == 0
