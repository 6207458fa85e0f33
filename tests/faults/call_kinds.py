"""A service with calls of every kind: their ids ask to be `answered`, `refused`, `broken` off, or to stay `open`."""

import asyncio
from collections.abc import AsyncIterator, Sequence
from typing import Any

from freerein.api.learning.v1 import learning_pb2
from freerein.errors import NotFound, OutOfStorage
from freerein.serving.health import Health
from freerein.serving.lifecycle import Service, run
from freerein.serving.limits import Limits
from freerein.serving.methods import methods_of
from freerein.serving.metrics import Metrics
from freerein.serving.settings import ServiceSettings
from freerein.types.learning import Fit, GetFitResponse, WatchFitResponse

FIT = Fit("0" * 32, "running", {}, dataset="demos", model_name="default")


def check(asked: str) -> None:
    if asked == "refused":
        raise NotFound("There is no such fit.", field="id", hint="List them.")


def break_off(asked: str) -> None:
    if asked == "broken":
        raise OutOfStorage("The disk must work; it does not.", hint="Replace it.")


class Core:
    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return None  # the calls that nobody makes

    async def get_fit(self, request: Any) -> GetFitResponse:
        check(request.id)
        return GetFitResponse(FIT)

    async def watch_fit(self, request: Any) -> AsyncIterator[WatchFitResponse]:
        check(request.id)
        yield WatchFitResponse(0, FIT)
        break_off(request.id)
        if request.id == "open":
            await asyncio.Event().wait()


class Session:
    greeting = b"hello"

    async def answer(self, message: bytes) -> bytes:
        return message


async def open_session(query: Sequence[tuple[str, str]]) -> Session:
    check(dict(query)["id"])
    return Session()


def build(_settings: ServiceSettings, _limits: Limits, _metrics: Metrics, _health: Health) -> Service:
    async def nothing() -> None: ...

    methods = methods_of(learning_pb2.DESCRIPTOR.services_by_name["FitService"], Core())
    return Service("kinds", methods, nothing, nothing, lambda: "", open_websocket=open_session)


if __name__ == "__main__":
    run("kinds", ServiceSettings, build)
