"""Benchmark results, printed as tables and written as JSON."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from experiments.workbench.results import machine
from rich.console import Console
from rich.table import Table

from benchmarks.timing import Latencies, Rates

_SHARES = {"p50": 0.5, "p99": 0.99}


@dataclass(frozen=True)
class Ratio:
    """A ratio of two measurements, and its bar: the required value, if any."""

    name: str
    value: float
    at_least: float | None = None
    at_most: float | None = None

    @property
    def bar(self) -> str | None:
        """The required value."""
        if self.at_least is not None:
            return f">= {self.at_least:.2f}"
        return None if self.at_most is None else f"<= {self.at_most:.2f}"

    @property
    def is_met(self) -> bool | None:
        """Whether the bar is met; None without a bar."""
        if self.at_least is not None:
            return self.value >= self.at_least
        return None if self.at_most is None else self.value <= self.at_most


@dataclass(frozen=True)
class Results:
    """Ratios, and by benchmark the measured rates and latencies."""

    ratios: tuple[Ratio, ...] = ()
    rates: dict[str, Rates] = field(default_factory=dict)
    latencies: dict[str, Latencies] = field(default_factory=dict)

    def __add__(self, other: "Results") -> "Results":
        return Results(self.ratios + other.ratios, self.rates | other.rates, self.latencies | other.latencies)


def show(results: Results) -> None:
    """Prints the ratios; what they are made of is in the summary."""
    ratios = Table("ratio", "value", "bar", "met", title="Ratios")
    for ratio in results.ratios:
        ratios.add_row(
            ratio.name, f"{ratio.value:.2f}", ratio.bar or "", {None: "", True: "yes"}.get(ratio.is_met, "no")
        )
    Console().print(ratios)


def write(results: Results, path: Path, *, load: Sequence[float]) -> None:
    """Writes results, machine, its load averages before the run, and package versions as JSON."""
    document = {
        "ratios": {
            ratio.name: {"value": round(ratio.value, 4), "bar": ratio.bar, "met": ratio.is_met}
            for ratio in results.ratios
        },
        "raw": {
            f"{benchmark}.{name}": {"unit": f"{times.unit}/s", "median": times.rate(name), "rounds": times.rates[name]}
            for benchmark, times in results.rates.items()
            for name in times.rates
        },
        "latencies": {
            f"{benchmark}.{name}": {
                f"{quantile}_ms": [round(1e3 * value, 4) for value in latencies.quantiles(name, share)]
                for quantile, share in _SHARES.items()
            }
            for benchmark, latencies in results.latencies.items()
            for name in latencies.seconds
        },
        "machine": {**machine(), "load": load},
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(document, indent=2) + "\n")
