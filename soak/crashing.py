"""Clients that die in the middle of a call: their connections are reset."""

import asyncio
import socket
import struct
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from typing import cast

_RESET = struct.pack("ii", 1, 0)  # close with RST, not FIN
_BLOCK = 1 << 16


@asynccontextmanager
async def dying_connection(address: str) -> AsyncIterator[str]:
    """Yields an address that leads to another; at the end of the block all its connections are reset."""
    host, _, port = address.rpartition(":")
    clients: list[asyncio.StreamWriter] = []
    serving: list[asyncio.Task[None]] = []

    async def accept(requests: asyncio.StreamReader, client: asyncio.StreamWriter) -> None:
        serving.append(cast(asyncio.Task[None], asyncio.current_task()))
        clients.append(client)
        replies, service = await asyncio.open_connection(host, int(port))
        await asyncio.gather(_pass(requests, service), _pass(replies, client))

    server = await asyncio.start_server(accept, "127.0.0.1", 0)
    try:
        yield f"127.0.0.1:{server.sockets[0].getsockname()[1]}"
    finally:
        server.close()
        await asyncio.sleep(0)  # who was accepted is in `serving` now
        for client in clients:
            _reset(client)
        await asyncio.gather(*serving)


async def _pass(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Passes bytes on until one side is gone; then the other is reset, too."""
    with suppress(OSError):
        while block := await reader.read(_BLOCK):
            writer.write(block)
            await writer.drain()
    _reset(writer)


def _reset(writer: asyncio.StreamWriter) -> None:
    with suppress(OSError):
        writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
    writer.transport.abort()
