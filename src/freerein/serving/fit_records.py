"""Fits on disk: what was asked, and every change since, one line each. The last line is how the fit stands.

<root>/<id>/request.json   what StartFit was sent; written whole before the fit is acknowledged
<root>/<id>/events.jsonl   the fit after each change, numbered from 0 by line
<root>/<id>/work/          the child process's own folder
"""

import asyncio
import json
import os
from pathlib import Path
from typing import Any

from freerein import wire
from freerein.atomic_files import write_atomic
from freerein.errors import NotFound
from freerein.serving.rest.schemas import schema_of
from freerein.types.common import check_id
from freerein.types.learning import Fit, StartFitRequest

_SCHEMA = schema_of(wire.descriptor_of(Fit))


class FitRecords:
    """All fits of one service, in memory as on disk.

    Args:
        root: Where they lie; made when missing.
    """

    def __init__(self, root: Path) -> None:
        self._root = root
        self._events: dict[str, list[Fit]] = {}
        self._requests: dict[str, StartFitRequest] = {}
        self._changed = asyncio.Condition()
        for path in sorted(
            root.glob("*/events.jsonl"), key=lambda found: (found.parent / "request.json").stat().st_mtime
        ):
            if events := _read_events(path):  # without one the fit was never acknowledged
                request = json.loads((path.parent / "request.json").read_bytes())
                self._requests[path.parent.name] = StartFitRequest(**request)
                self._events[path.parent.name] = events

    def all(self) -> tuple[Fit, ...]:
        """Returns all fits, oldest first."""
        return tuple(events[-1] for events in self._events.values())

    def fit(self, fit_id: str) -> Fit:
        """Returns a fit as it stands.

        Raises:
            NotFound: There is none of that id.
        """
        return self.events(fit_id)[-1]

    def events(self, fit_id: str) -> list[Fit]:
        """Returns a fit after each of its changes.

        Raises:
            NotFound: There is none of that id.
        """
        if check_id(fit_id, field="id") not in self._events:
            raise NotFound("There is no fit of this id.", field="id", hint="GET /v1/list-fits names them.")
        return self._events[fit_id]

    def started_by(self, key: str) -> tuple[StartFitRequest, Fit] | None:
        """Returns the request with an idempotency key, and its fit."""
        for fit_id, request in self._requests.items():
            if key and request.idempotency_key == key:
                return request, self.fit(fit_id)
        return None

    def work(self, fit_id: str) -> Path:
        """Returns the child process's folder."""
        return self._root / fit_id / "work"

    async def add(self, fit: Fit, request: StartFitRequest) -> None:
        """Records a new fit, durably, with what its child needs to know in `work/config.json`."""
        config = json.dumps({"dataset": fit.dataset, "config": fit.config}).encode()
        write_atomic(self.work(fit.id) / "config.json", config)
        write_atomic(self._root / fit.id / "request.json", json.dumps(wire.to_json(request)).encode())
        _append_durably(self._root / fit.id / "events.jsonl", fit)
        self._events[fit.id], self._requests[fit.id] = [fit], request

    async def change(self, fit: Fit) -> None:
        """Records a change of a fit, durably, and wakes those who wait for it.

        Raises:
            OSError: The disk is full, or broken; nothing has changed.
        """
        _append_durably(self._root / fit.id / "events.jsonl", fit)
        self._events[fit.id].append(fit)
        async with self._changed:
            self._changed.notify_all()

    async def wait_beyond(self, fit_id: str, count: int) -> bool:
        """Returns True when a fit has more than `count` events, or has ended."""
        events = self._events[fit_id]
        async with self._changed:
            await self._changed.wait_for(lambda: len(events) > count or events[-1].ended)
        return True


def _append_durably(path: Path, fit: Fit) -> None:
    """Appends a line, or, where the disk does not take the whole of it, nothing."""
    line = json.dumps(wire.to_json(fit)).encode() + b"\n"
    with path.open("ab", buffering=0) as file:
        before = file.tell()
        try:
            while line:
                line = line[file.write(line) :]
            os.fsync(file.fileno())
        except OSError:
            file.truncate(before)
            raise


def _read_events(path: Path) -> list[Fit]:
    """Returns the whole lines of an event file; a last line torn by a crash was never acknowledged, and is cut off."""
    data = path.read_bytes()
    whole = data[: data.rfind(b"\n") + 1]
    if len(whole) < len(data):
        os.truncate(path, len(whole))
    return [_fit(json.loads(line)) for line in whole.splitlines()]


def _fit(values: dict[str, Any]) -> Fit:
    return wire.unpack(_SCHEMA.model_validate(values), Fit)
