"""HTTP/2 spoken by hand, as no gRPC client would: headers without a message, half a message, floods of frames."""

import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import suppress
from typing import Any, Self

import hpack

DATA, HEADERS, RST_STREAM, SETTINGS, PING, GOAWAY, WINDOW_UPDATE, CONTINUATION = 0, 1, 3, 4, 6, 7, 8, 9
END_STREAM, END_HEADERS, ACK = 1, 4, 1
_PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"
_FRAME_BYTES = 16_384
_FIRST_WINDOW = 65_535


def frame(kind: int, flags: int, stream: int, payload: bytes = b"") -> bytes:
    return struct.pack(">I", len(payload))[1:] + struct.pack(">BBI", kind, flags, stream) + payload


class Http2:
    """A connection that respects the windows of the server, and no other rule.

    Attributes:
        last_stream: Number of the newest stream.
        ended: Status of every ended stream, empty where the server reset it without one.
        messages: What these statuses say.
        closed: Whether the server has closed the connection.
    """

    def __init__(self, port: int) -> None:
        self._socket = socket.create_connection(("127.0.0.1", port), 60)
        self._encoder, self._decoder = hpack.Encoder(), hpack.Decoder()
        self.last_stream = -1
        self._stream_window = self._window = _FIRST_WINDOW
        self._windows: dict[int, int] = {}
        self._changed = threading.Condition()
        self.ended: dict[int, str] = {}
        self.messages: dict[int, str] = {}
        self.closed = False
        self.send(_PREFACE + frame(SETTINGS, 0, 0))
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._reader.join()
        self._socket.close()

    def send(self, frames: bytes) -> None:
        """Sends bytes, nothing when the server has closed the connection."""
        try:
            self._socket.sendall(frames)
        except OSError:
            self.closed = True

    def headers(self, path: str, *metadata: tuple[bytes, bytes]) -> bytes:
        pseudo = [(b":method", b"POST"), (b":scheme", b"http"), (b":path", path.encode()), (b":authority", b"robot")]
        fields = [*pseudo, (b"te", b"trailers"), (b"content-type", b"application/grpc"), *metadata]
        return bytes(self._encoder.encode(fields))

    def next_stream(self) -> int:
        """Returns the number of a new stream."""
        self.last_stream += 2
        return self.last_stream

    def call(self, path: str, *metadata: tuple[bytes, bytes]) -> int:
        """Begins a call, of which no message comes yet; returns its stream."""
        stream = self.next_stream()
        with self._changed:
            self._windows[stream] = self._stream_window
        self.send(frame(HEADERS, END_HEADERS, stream, self.headers(path, *metadata)))
        return stream

    def data(self, stream: int, payload: bytes) -> int:
        """Sends bytes of a message as the windows allow, until the stream ends; returns how many went."""
        sent = 0
        while sent < len(payload):
            with self._changed:
                self._changed.wait_for(lambda: self._open(stream) > 0 or self._is_over(stream), 60)
                size = min(self._open(stream), _FRAME_BYTES, len(payload) - sent)
                if self._is_over(stream) or size <= 0:
                    return sent
                self._window -= size
                self._windows[stream] -= size
            self.send(frame(DATA, 0, stream, payload[sent : sent + size]))
            sent += size
        return sent

    def wait_for_end(self, stream: int, timeout_s: float) -> str:
        """Returns the gRPC status with which the server ends a call."""
        with self._changed:
            self._changed.wait_for(lambda: self._is_over(stream), timeout_s)
            return self.ended[stream]

    def _open(self, stream: int) -> int:
        return min(self._window, self._windows[stream])

    def _is_over(self, stream: int) -> bool:
        return stream in self.ended or self.closed

    def _read(self) -> None:
        for kind, flags, stream, payload in self._frames():
            with self._changed:
                self._take(kind, flags, stream, payload)
                self._changed.notify_all()
        with self._changed:
            self.closed = True
            self._changed.notify_all()

    def _take(self, kind: int, flags: int, stream: int, payload: bytes) -> None:
        if kind == SETTINGS and not flags & ACK:
            settings = dict(struct.iter_unpack(">HI", payload))
            grown = settings.get(4, self._stream_window) - self._stream_window
            self._stream_window += grown
            self._windows = {each: size + grown for each, size in self._windows.items()}
            self.send(frame(SETTINGS, ACK, 0))
        elif kind == WINDOW_UPDATE:
            (size,) = struct.unpack(">I", payload)
            if stream:
                self._windows[stream] = self._windows.get(stream, 0) + size
            else:
                self._window += size
        elif kind == HEADERS:
            fields = dict(self._decoder.decode(payload))
            if "grpc-status" in fields:
                self.ended[stream] = fields["grpc-status"]
                self.messages[stream] = fields.get("grpc-message", "")
        elif kind == RST_STREAM:
            self.ended.setdefault(stream, "")

    def _frames(self) -> Iterator[tuple[int, int, int, bytes]]:
        with self._socket.makefile("rb") as received, suppress(OSError, EOFError):
            while True:
                header = self._exactly(received, 9)
                kind, flags, stream = struct.unpack(">BBI", header[3:])
                payload = self._exactly(received, int.from_bytes(header[:3], "big"))
                yield kind, flags, stream & 0x7FFFFFFF, payload

    @staticmethod
    def _exactly(received: Any, size: int) -> bytes:
        """Reads so many bytes; raises EOFError where a connection ends, which may be within a frame."""
        content = bytes(received.read(size))
        if len(content) < size:
            raise EOFError
        return content
