"""The responses of a stream, to the status that the server ended it with.

`grpc.aio` replaces that status by `INTERNAL` where a write fails after it (https://github.com/grpc/grpc/issues/36066):
a client that sends while the server refuses would not be told why. This file goes with the release that mends it.
"""

from collections.abc import AsyncGenerator, Coroutine
from typing import Any

import grpc
from grpc import aio

WRITE_FAILED = "Internal error from Core"  # the details of the status that replaces the server's


async def stream_responses(call: Any) -> AsyncGenerator[Any, None]:
    """Yields the responses of a streaming call of `grpc.aio`; raises `AioRpcError` as the server ended it."""
    errors: list[aio.AioRpcError] = []  # of each status, the server's first
    call.add_done_callback(lambda ended: errors.append(_error_of(ended)))
    try:
        async for response in call:
            yield response
    except aio.AioRpcError as error:
        sent = errors[0] if error.details() == WRITE_FAILED else error
        if sent.code() is not grpc.StatusCode.OK:
            raise sent from None


def _error_of(ended: Any) -> aio.AioRpcError:
    code, initial, trailing = (_now(part()) for part in (ended.code, ended.initial_metadata, ended.trailing_metadata))
    return aio.AioRpcError(code, initial, trailing, details=_now(ended.details()))


def _now(known: Coroutine[Any, Any, object]) -> Any:
    """Returns what a coroutine returns without waiting, as those of a call that has ended do."""
    try:
        known.send(None)
    except StopIteration as end:
        return end.value
    raise AssertionError("The call has a status.")
