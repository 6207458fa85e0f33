"""Large replies in parts: no step of their encoding is long, for the event loop waits while one runs."""

import uuid
from collections.abc import Sequence
from typing import Any

import orjson
from pybase64 import b64encode  # six times as fast as Python's
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from freerein import wire
from freerein.serving.rest import tensor_lists

_LARGE_BYTES = 2**20
_PIECE_BYTES = 256 * 1024
_PART_BYTES = _PIECE_BYTES // 4 * 3  # a piece as base64


def json_parts(response: object, *, as_lists: bool) -> list[bytes]:
    """Returns a reply as JSON, in parts that are never joined; with `as_lists`, tensors are lists."""
    mark, large = uuid.uuid4().hex, list[list[bytes]]()

    def write_bytes(raw: Any) -> str:
        if len(raw) < _LARGE_BYTES:
            return wire.base64_text(raw)
        large.append([b64encode(raw[at : at + _PART_BYTES]) for at in range(0, len(raw), _PART_BYTES)])
        return mark

    to_json = tensor_lists.reply_json if as_lists else wire.to_json
    first, *others = orjson.dumps(to_json(response, write_bytes=write_bytes)).split(mark.encode())
    return [first, *(part for encoded, text in zip(large, others, strict=True) for part in (*encoded, text))]


class PartsResponse(Response):
    """A response that is sent in pieces: the rest of a large one counts until the client has read what is before."""

    def __init__(self, parts: Sequence[bytes], *, media_type: str) -> None:
        super().__init__(media_type=media_type, headers={"content-length": str(sum(map(len, parts)))})
        self._parts = parts

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Sends it."""
        await send({"type": "http.response.start", "status": self.status_code, "headers": self.raw_headers})
        if sum(map(len, self._parts)) <= _PIECE_BYTES:
            await send({"type": "http.response.body", "body": b"".join(self._parts)})
            return
        for part in self._parts:
            for at in range(0, len(part), _PIECE_BYTES):
                await send({"type": "http.response.body", "body": part[at : at + _PIECE_BYTES], "more_body": True})
        await send({"type": "http.response.body", "body": b"", "more_body": False})
