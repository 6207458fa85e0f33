"""The connection to one service."""

import asyncio
import os
import re
import threading
from functools import cache
from ipaddress import ip_address
from typing import Any
from weakref import WeakSet

import grpc
from grpc import aio

from freerein.clients import retry_policy
from freerein.errors import FailedPrecondition, must_be

MAX_MESSAGE_BYTES = 64 * 2**20
_NO_PROXIES = ("no_grpc_proxy", "no_proxy")
_PROXIES = ("grpc_proxy", "https_proxy", "http_proxy")  # those of gRPC, the first counts
_TOKEN = re.compile(r"[!-~]*")  # what a header carries unchanged

_OPTIONS: tuple[tuple[str, int], ...] = (
    ("grpc.max_send_message_length", MAX_MESSAGE_BYTES),
    ("grpc.max_receive_message_length", MAX_MESSAGE_BYTES),
    # A service that hangs is detected 1 s after a ping. The ping's own timeout, 60 s by default, counts; long calls
    # send no data, so pings without data must not be limited.
    ("grpc.keepalive_timeout_ms", 1_000),
    ("grpc.http2.ping_timeout_ms", 1_000),
    ("grpc.http2.max_pings_without_data", 0),
    # Bandwidth probes are pings, too, whose answers queue behind data and time out on a slow link. Without them the
    # window must be set.
    ("grpc.http2.bdp_probe", 0),
    ("grpc.http2.lookahead_bytes", 4 * 2**20),
    # A service that restarts, possibly at another address of the same name, is found within seconds.
    ("grpc.initial_reconnect_backoff_ms", 100),
    ("grpc.max_reconnect_backoff_ms", 1_000),
    ("grpc.dns_min_time_between_resolutions_ms", 5_000),
    # A request larger than this buffer is not retried.
    ("grpc.per_rpc_retry_buffer_size", MAX_MESSAGE_BYTES),
)


class Channel:
    """A gRPC connection to one service, opened by the first call and bound to its event loop.

    Args:
        address: `host:port`. On loopback no proxy of the environment is used.
        token: Bearer token, printable ASCII without spaces; empty for none.
        root_certificates: PEM root certificates for TLS; None for no TLS.
        keepalive_s: Seconds of silence before a ping, at least 1. A service that hangs is noticed 1 s later. On a slow
            line a ping waits behind what is being sent, so a short time takes a long upload for a silence.

    Raises:
        InvalidInput: The token has other characters, or the time is too short.

    Attributes:
        methods: Methods of the gRPC channel, by RPC; forgotten when it is closed, since they keep gRPC running.
    """

    def __init__(
        self, address: str, *, token: str = "", root_certificates: bytes | None = None, keepalive_s: float = 10.0
    ) -> None:
        if not _TOKEN.fullmatch(token):
            hint = "Give the token as the service has it in FREEREIN_TOKEN, without line breaks."
            rule = "printable ASCII without spaces"
            raise must_be("The token", rule, "other characters", field="token", hint=hint)
        if not keepalive_s >= 1:
            hint = "Leave it out for 10 s."
            raise must_be("keepalive_s", "at least 1 second, or infinity for no pings", f"{keepalive_s:g}", hint=hint)
        self.address = address
        self._keepalive_ms = int(min(keepalive_s * 1000, 2**31 - 1))
        self._authorization = (("authorization", f"Bearer {token}"),) if token else ()
        self._root_certificates = root_certificates
        self._grpc: aio.Channel | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._is_closed = False
        self.methods: dict[str, Any] = {}

    @property
    def proxy(self) -> str:
        """Name of the environment variable whose proxy calls take; empty for none."""
        if is_loopback(self.address):
            return ""
        host = self.address.rpartition(":")[0]
        unproxied = next(filter(None, map(os.environ.get, _NO_PROXIES)), "")
        if any(host.endswith(each) for each in map(str.strip, unproxied.split(",")) if each):
            return ""
        return next(filter(os.environ.get, _PROXIES), "")

    @property
    def grpc(self) -> aio.Channel:
        """The gRPC channel; access within a running event loop.

        Raises:
            FailedPrecondition: The channel is closed, belongs to another event loop, or the process was forked while
                its parent had an open one.
        """
        if self._is_closed:
            raise FailedPrecondition("The client must be open; it is closed.", hint="Make another one.")
        loop = asyncio.get_running_loop()
        if self._grpc is not None and self._loop is not loop:
            raise FailedPrecondition(
                "A client must be used in the event loop of its first call; this is another.",
                hint="Make a client in each, such as within the coroutine that asyncio.run gets, or use SyncClient.",
            )
        if self._grpc is None:
            self._loop = loop
            _check_not_forked()
            _open_channels.add(self)
            options = (
                *_OPTIONS,
                ("grpc.keepalive_time_ms", self._keepalive_ms),
                ("grpc.enable_http_proxy", int(not is_loopback(self.address))),
                ("grpc.service_config", retry_policy.service_config()),
            )
            if self._root_certificates is None:
                self._grpc = aio.insecure_channel(self.address, options)
            else:
                credentials = grpc.ssl_channel_credentials(self._root_certificates)
                self._grpc = aio.secure_channel(self.address, credentials, options)
        return self._grpc

    async def close(self) -> None:
        """Cancels the calls in flight and closes the connection."""
        self._is_closed = True
        if self._grpc is not None:
            await self._grpc.close()
            self._grpc = None
            self.methods.clear()
            _open_channels.discard(self)

    def metadata(self, request_id: str) -> tuple[tuple[str, str], ...]:
        """Returns the metadata of a call."""
        return (("x-request-id", request_id), *self._authorization)


def is_loopback(address: str) -> bool:
    """Returns whether the host of an address, `host:port`, is this machine."""
    host = address.rpartition(":")[0].strip("[]")
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


# gRPC crashes or hangs in a process that was forked while it was in use.
_open_channels: "WeakSet[Channel]" = WeakSet()
_was_forked = threading.Event()


def _check_not_forked() -> None:
    if _was_forked.is_set():
        raise FailedPrecondition(
            "A process whose parent has open clients must be started by spawn or forkserver to call services; "
            "this one was forked.",
            hint="Close them first, or write for example: AsyncVectorEnv(..., context='forkserver').",
        )
    _watch_forks()


@cache
def _watch_forks() -> None:
    os.register_at_fork(after_in_child=lambda: _was_forked.set() if _open_channels else None)
