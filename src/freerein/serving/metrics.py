"""Prometheus metrics of one service. Labels come from fixed sets, never from a request."""

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest

_LATENCY_BUCKETS_S = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0)
_BATCH_BUCKETS = (1, 2, 4, 8, 16, 32)


class Metrics:
    """The metrics, on a registry of their own so that two services can live in one test process.

    Attributes:
        calls: Calls answered, by door, method and code.
        latency: Seconds from request to reply, by door and method.
        in_flight: Calls being answered, by door.
        cancelled: Calls whose caller went away, by door.
        queued: Items waiting for the model.
        batches: Items per model call.
    """

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        self.calls = Counter(
            "freerein_calls_total", "Calls answered.", ("door", "method", "code"), registry=self.registry
        )
        self.latency = Histogram(
            "freerein_call_seconds",
            "From request to reply.",
            ("door", "method"),
            buckets=_LATENCY_BUCKETS_S,
            registry=self.registry,
        )
        self.in_flight = Gauge("freerein_calls_in_flight", "Calls being answered.", ("door",), registry=self.registry)
        self.cancelled = Counter(
            "freerein_cancelled_total", "Calls whose caller went away.", ("door",), registry=self.registry
        )
        self.queued = Gauge("freerein_queued_items", "Items waiting for the model.", registry=self.registry)
        self.batches = Histogram(
            "freerein_batch_size", "Items per model call.", buckets=_BATCH_BUCKETS, registry=self.registry
        )

    def text(self) -> bytes:
        """Returns everything in Prometheus' text format."""
        return generate_latest(self.registry)
