"""Records calls: over REST, gRPC and the WebSocket each has one log line of the same fields, and the same metrics."""

import asyncio
import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import structlog

from freerein.atomic_files import OUT_OF_FILES, out_of_files, storage_errors
from freerein.errors import Cancelled, Internal, ServiceError
from freerein.serving.error_replies import internal_error
from freerein.serving.metrics import Metrics

OK = "ok"
OTHER = "other"
"""The method of requests that are no calls, such as health checks and unknown paths: counted, but not logged."""
_log = logging.getLogger(__name__)


@dataclass
class CallRecord:
    """The record of one call.

    Attributes:
        code: `ok`, or the code of the error that ended it.
    """

    code: str = OK


@contextmanager
def machine_errors() -> Iterator[None]:
    """Turns the errors of a disk into `OutOfStorage`, and too many open files into `Unavailable`."""
    with storage_errors():
        try:
            yield
        except OSError as error:
            if error.errno not in OUT_OF_FILES:
                raise
            raise out_of_files() from error


class CallRecorder:
    """Records the calls of one method over one protocol; of a stream no latency, but whether it is open."""

    def __init__(self, metrics: Metrics, protocol: str, method: str, *, is_stream: bool = False) -> None:
        self._metrics = metrics
        self._protocol = protocol
        self._method = method
        self._is_stream = is_stream
        self._gauges = [metrics.in_flight.labels(protocol)]
        if is_stream:
            self._gauges.append(metrics.open_streams.labels(protocol, method))

    @contextmanager
    def record(self, request_id: str) -> Iterator[CallRecord]:
        """Records the call that the block answers, by the error that ends it; `machine_errors` become `ServiceError`s.

        Raises:
            Internal: In place of an unexpected exception, which is logged.
        """
        call, started = CallRecord(), time.perf_counter()
        for gauge in self._gauges:
            gauge.inc()
        bound = structlog.contextvars.bind_contextvars(request_id=request_id)
        try:
            with machine_errors():
                yield call
        except ServiceError as error:
            call.code = error.code
            raise
        except asyncio.CancelledError:
            call.code = Cancelled.code
            raise
        except Exception:  # every other exception is a bug
            call.code = Internal.code
            _log.exception("bug", extra={"protocol": self._protocol, "method": self._method})
            raise internal_error() from None
        finally:
            for gauge in self._gauges:
                gauge.dec()
            self._end(call.code, time.perf_counter() - started)
            structlog.contextvars.reset_contextvars(**bound)

    def _end(self, code: str, seconds: float) -> None:
        self._metrics.calls.labels(self._protocol, self._method, code).inc()
        if not self._is_stream:
            self._metrics.latency.labels(self._protocol, self._method).observe(seconds)
        if code == Cancelled.code:
            self._metrics.cancelled.labels(self._protocol).inc()
        if self._method != OTHER:
            level = logging.DEBUG if code == OK and not self._is_stream else logging.INFO
            fields = {"protocol": self._protocol, "method": self._method, "code": code, "ms": round(seconds * 1e3, 3)}
            _log.log(level, "call", extra=fields)
