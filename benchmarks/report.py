"""What was measured: as a table for people, as JSON for programs."""

import json
import os
import platform
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Literal

from rich.console import Console
from rich.table import Table

from benchmarks.latencies import Latencies
from benchmarks.rounds import Times

_PACKAGES = ("freerein", "grpcio", "gymnasium", "httpx", "mujoco", "numpy", "protobuf", "torch", "uvicorn", "uvloop")
_SHARES = {"p50": 0.5, "p99": 0.99}


@dataclass(frozen=True)
class Bar:
    """What a ratio has to be.

    Attributes:
        side: On which side of the limit.
        limit: The limit.
    """

    side: Literal["at least", "at most"]
    limit: float

    def is_met(self, value: float) -> bool:
        """Returns whether a ratio is on the right side."""
        return value >= self.limit if self.side == "at least" else value <= self.limit

    def __str__(self) -> str:
        return f"{'>=' if self.side == 'at least' else '<='} {self.limit:.2f}"


@dataclass(frozen=True)
class Ratio:
    """One figure.

    Attributes:
        name: Its name, under which it is published.
        value: How many times as much.
        bar: What it has to be; None where nothing was promised.
    """

    name: str
    value: float
    bar: Bar | None = None

    @property
    def is_met(self) -> bool | None:
        """Whether the bar is met; None without a bar."""
        return None if self.bar is None else self.bar.is_met(self.value)


@dataclass(frozen=True)
class Findings:
    """What benchmarks found.

    Attributes:
        ratios: The figures.
        raw: By name, what the figures were made from.
        latencies: By name, what figures about single calls were made from.
    """

    ratios: tuple[Ratio, ...] = ()
    raw: dict[str, Times] = field(default_factory=dict)
    latencies: dict[str, Latencies] = field(default_factory=dict)

    def __add__(self, other: "Findings") -> "Findings":
        return Findings(self.ratios + other.ratios, self.raw | other.raw, self.latencies | other.latencies)


def show(findings: Findings) -> None:
    """Prints the figures and what they were made from."""
    Console().print(*(table for table in _tables(findings) if table.row_count))


def _tables(findings: Findings) -> tuple[Table, ...]:
    rates = Table("measured", "per second", "ms each", "of", title="Medians")
    for race, times in findings.raw.items():
        for name in times.rates:
            rate = times.rate(name)
            rates.add_row(f"{race}.{name}", f"{rate:,.1f}", f"{1e3 / rate:.3f}", times.unit)
    calls = Table("call", *(f"{name} ms" for name in _SHARES), title="Latencies, medians of rounds")
    for race, latencies in findings.latencies.items():
        for name in latencies.seconds:
            values = (latencies.quantile(name, share) for share in _SHARES.values())
            calls.add_row(f"{race}.{name}", *(f"{1e3 * value:.3f}" for value in values))
    ratios = Table("ratio", "value", "bar", "met", title="Ratios")
    for ratio in findings.ratios:
        ratios.add_row(ratio.name, f"{ratio.value:.2f}", str(ratio.bar or ""), _tick(ratio.is_met))
    return rates, calls, ratios


def write(findings: Findings, path: Path, *, load: Sequence[float]) -> None:
    """Writes everything, with the machine and the versions.

    Args:
        findings: What was found.
        path: Where to.
        load: The machine's load averages before the run, over 1, 5 and 15 minutes.
    """
    document = {
        "ratios": {
            ratio.name: {
                "value": round(ratio.value, 4),
                "bar": None if ratio.bar is None else str(ratio.bar),
                "met": ratio.is_met,
            }
            for ratio in findings.ratios
        },
        "raw": {
            f"{race}.{name}": {"unit": f"{times.unit}/s", "median": times.rate(name), "rounds": times.rates[name]}
            for race, times in findings.raw.items()
            for name in times.rates
        },
        "latencies": {
            f"{race}.{name}": {
                f"{quantile}_ms": [round(1e3 * value, 4) for value in latencies.quantiles(name, share)]
                for quantile, share in _SHARES.items()
            }
            for race, latencies in findings.latencies.items()
            for name in latencies.seconds
        },
        "machine": {"processor": _processor(), "cores": os.cpu_count(), "system": platform.platform(), "load": load},
        "versions": {"python": platform.python_version(), **{name: version(name) for name in _PACKAGES}},
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(document, indent=2) + "\n")


def _tick(met: bool | None) -> str:
    return "" if met is None else "[green]yes" if met else "[bold red]no"


def _processor() -> str:
    """Returns what Linux calls the processor."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.is_file() else []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.machine())
