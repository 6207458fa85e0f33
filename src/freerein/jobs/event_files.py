"""Event files, which TensorBoard shows: scalars of a fit or run in the groups `rollout`, `train` and `time`.

Written here because fits run where TensorBoard is not installed. The format is TFRecord's, of messages `Event`
(tensorboard/compat/proto/event.proto), of which four fields are needed.
"""

import math
import os
import struct
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from freerein.jobs.wall_clock import now_ns

_ROLLOUT = ("episode_", "intrinsic_", "privileged")
_TIME = {"timesteps", "steps_per_s", "recoveries", "rejected"}
_START = bytes([0x08, 1])  # SessionLog: status = START; what was written from its step on is dropped
_POLYNOMIAL, _MASK = 0x82F63B78, 0xA282EAD8  # of CRC-32C, reflected; TFRecord's
_MAX_FLOAT = 3.4028234663852886e38  # of 32 bits


class EventFile:
    """A new event file of one attempt; a full or broken disk ends it silently, and not the fit or run.

    Args:
        folder: Folder of the job's event files.
        after: The last x that is kept; what earlier attempts wrote later will be written again.
        group: Group of the metrics that are neither of rollouts nor of time.
    """

    def __init__(self, folder: Path, *, after: int, group: str = "train") -> None:
        self._group = group
        self._is_whole = True
        seconds, rest = divmod(now_ns(), 10**9)  # files are read in order of their names
        self._path = folder / f"events.out.tfevents.{seconds:010d}.{rest:09d}.{os.getpid()}"
        with suppress(OSError):  # then no event can be written either
            folder.mkdir(parents=True, exist_ok=True)
        self._write(_field(3, b"brain.Event:2"))
        self._write(_varint_field(2, after + 1) + _field(7, _START))

    def append(self, x: int, metrics: Mapping[str, float]) -> None:
        """Adds the finite metrics of a row at an x: timesteps, or steps of a fit or run."""
        values = [
            _field(1, _field(1, tag(name, self._group).encode()) + _float_field(2, value))
            for name, value in metrics.items()
            if math.isfinite(value)
        ]
        self._write(_varint_field(2, x) + _field(5, b"".join(values)))

    def _write(self, event: bytes) -> None:
        """Appends an event, unless an earlier one could not be written: nothing after a part of one can be read."""
        event = struct.pack("<Bd", 1 << 3 | 1, now_ns() / 1e9) + event
        length = struct.pack("<Q", len(event))
        record = length + _checksum(length) + event + _checksum(event)
        if self._is_whole:
            self._is_whole = False
            with suppress(OSError), self._path.open("ab", buffering=0) as file:
                self._is_whole = file.write(record) == len(record)


def tag(name: str, group: str) -> str:
    """Returns a metric's name with its group; a name that has one already is left alone."""
    if "/" in name:
        return name
    if name in _TIME:
        return f"time/{name}"
    return f"rollout/{name}" if name.startswith(_ROLLOUT) else f"{group}/{name}"


def _field(number: int, content: bytes) -> bytes:
    return bytes([number << 3 | 2]) + _varint(len(content)) + content


def _varint_field(number: int, value: int) -> bytes:
    return bytes([number << 3]) + _varint(value)


def _float_field(number: int, value: float) -> bytes:
    return bytes([number << 3 | 5]) + struct.pack("<f", max(-_MAX_FLOAT, min(_MAX_FLOAT, value)))


def _varint(value: int) -> bytes:
    encoded = bytearray()
    while value > 0x7F:
        encoded.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*encoded, value])


def _checksum(data: bytes) -> bytes:
    """Returns TFRecord's masked CRC-32C."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc = _TABLE[(crc ^ byte) & 0xFF] ^ (crc >> 8)
    crc ^= 0xFFFFFFFF
    return struct.pack("<I", ((crc >> 15 | crc << 17) + _MASK) & 0xFFFFFFFF)


def _entry(index: int) -> int:
    for _ in range(8):
        index = (index >> 1) ^ (_POLYNOMIAL if index & 1 else 0)
    return index


_TABLE = tuple(_entry(index) for index in range(256))
