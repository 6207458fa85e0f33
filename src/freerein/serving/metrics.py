"""Prometheus metrics of one service. Label values come from fixed sets, never from a request."""

import asyncio
from concurrent.futures import ThreadPoolExecutor

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest

from freerein.serving.job_metrics import DataMetrics

_LATENCY_BUCKETS_S = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0)
_BATCH_BUCKETS = (1, 2, 4, 8, 16, 32)


class Metrics:
    """The metrics, on their own registry, so that one process can hold several services.

    Attributes:
        calls: Completed calls, by protocol (rest | grpc | websocket), method and code.
        latency: Seconds from request to reply of unary calls, by protocol and method.
        in_flight: Calls in progress, by protocol.
        open_streams: Streams that are open, by protocol and method.
        cancelled: Calls whose client disconnected, by protocol.
        queued: Items waiting for the model.
        stuck: Model threads in a call that has outlasted every deadline, 0 or 1.
        batches: Items per model call.
        data: What lies in the data directory.
    """

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        self.calls = Counter(
            "freerein_calls_total", "Completed calls.", ("protocol", "method", "code"), registry=self.registry
        )
        self.latency = Histogram(
            "freerein_call_seconds",
            "Seconds from request to reply of unary calls.",
            ("protocol", "method"),
            buckets=_LATENCY_BUCKETS_S,
            registry=self.registry,
        )
        self.in_flight = Gauge("freerein_calls_in_flight", "Calls in progress.", ("protocol",), registry=self.registry)
        self.open_streams = Gauge(
            "freerein_open_streams", "Streams that are open.", ("protocol", "method"), registry=self.registry
        )
        self.cancelled = Counter(
            "freerein_cancelled_total", "Calls whose client disconnected.", ("protocol",), registry=self.registry
        )
        self.queued = Gauge("freerein_queued_items", "Items waiting for the model.", registry=self.registry)
        self.stuck = Gauge(
            "freerein_stuck_threads", "Model threads in a call that outlasts every deadline.", registry=self.registry
        )
        self.batches = Histogram(
            "freerein_batch_size", "Items per model call.", buckets=_BATCH_BUCKETS, registry=self.registry
        )

        self.data = DataMetrics()
        self.registry.register(self.data)
        self._thread = ThreadPoolExecutor(1, "metrics")  # not one that decodes: a disk that hangs ends no decoding

    async def read(self) -> bytes:
        """Returns all metrics in the Prometheus text format; files are read off the event loop."""
        return await asyncio.get_running_loop().run_in_executor(self._thread, self.text)

    def text(self) -> bytes:
        """Returns all metrics in the Prometheus text format."""
        return generate_latest(self.registry)
