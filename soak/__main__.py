"""Soaks the services: `python -m soak [--minutes 20]`. Exits with 1 when something is wrong."""

import argparse
import asyncio
import math
import sys
import time
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from freerein.errors import Overloaded
from freerein.stack import Stack
from freerein.types.sim import CloseSessionRequest
from soak import sequences, services, watch
from soak.leak import MOST_MIB_PER_10K_CALLS, Sample, growth_mib_per_10k_calls
from soak.load import Load
from soak.questions import Services
from soak.watch import Held

_SAMPLES = 60
_WARM_UP = 1 / 6
_QUIET_S = 15.0
"""Until sessions that nobody closed have ended."""

_MOST_MORE = 8
"""Threads or file descriptors more than after the warm-up that are no leak: pools fill up late."""

_SESSIONS = 64


@dataclass
class Findings:
    """The soak's measurements."""

    samples: dict[str, list[Sample]] = field(default_factory=lambda: defaultdict(list))
    before: dict[str, Held] = field(default_factory=dict)
    after: dict[str, Held] = field(default_factory=dict)
    failures: list[str] = field(default_factory=list)

    def growth(self, service: str) -> float:
        """Returns the memory that a service gains, in MiB per 10 000 calls; NaN for too few samples."""
        try:
            return growth_mib_per_10k_calls(self.samples[service])
        except ValueError:
            return math.nan

    def all_failures(self) -> list[str]:
        """Returns what is wrong, leaks included."""
        leaks = [
            f"{name}: memory grows by {growth:.2f} MiB per 10 000 calls"
            if math.isfinite(growth)
            else f"{name}: too few samples to measure its memory"
            for name, growth in ((name, self.growth(name)) for name in self.before)
            if not growth <= MOST_MIB_PER_10K_CALLS  # NaN is a failure, too
        ]
        kept = [
            f"{name}: {before} before the load, {self.after.get(name)} after it"
            for name, before in self.before.items()
            if name not in self.after or has_more(self.after[name], before)
        ]
        return [*self.failures, *leaks, *kept]


def has_more(after: Held, before: Held) -> bool:
    """Returns whether a service has kept something."""
    return (
        after.busy > before.busy
        or after.threads > before.threads + _MOST_MORE
        or after.descriptors > before.descriptors + _MOST_MORE
    )


async def soak(minutes: float) -> Findings:
    """Runs the services under load and returns what was measured."""
    findings, seconds = Findings(), 60 * minutes
    with TemporaryDirectory(prefix="soak-") as folder:
        async with services.start(Path(folder)) as (stack, running):
            load = Load(running, seed=0)
            await load.learn_answers()
            print(f"Warming up for {_WARM_UP * seconds:.0f} s.", flush=True)
            pids = [status.pid for status in stack.statuses]
            await load.run(_WARM_UP * seconds)
            await asyncio.sleep(_QUIET_S)
            findings.before = await watch.held(stack, running.rest, findings.failures)
            async with asyncio.TaskGroup() as group:
                loading = group.create_task(load.run((1 - _WARM_UP) * seconds))
                group.create_task(measure(findings, load, loading, stack, running, every_s=seconds / _SAMPLES))
            await asyncio.sleep(_QUIET_S)
            findings.after = await watch.held(stack, running.rest, findings.failures)
            findings.failures += load.tally.failures + await sessions_left(running)
            if pids != [status.pid for status in stack.statuses]:
                findings.failures.append("A service was restarted.")
        findings.failures += watch.complaints(Path(folder) / "logs")
    return findings


async def measure(
    findings: Findings, load: Load, loading: "asyncio.Task[None]", stack: Stack, running: Services, *, every_s: float
) -> None:
    """Samples all services until the load ends, and shows how it goes."""
    begun, told = time.monotonic(), 0
    while not loading.done():
        await asyncio.wait([loading], timeout=every_s)
        for name, sample in (await watch.sample(stack, running.rest, findings.failures)).items():
            findings.samples[name].append(sample)
        memory = "  ".join(f"{name} {some[-1].rss_mib:.0f}" for name, some in findings.samples.items())
        came, failed = load.tally.clients.total(), len(load.tally.failures)
        print(f"{time.monotonic() - begun:6.0f} s  {came:7} clients  {failed} failures  MiB: {memory}", flush=True)
        for failure in load.tally.failures[told:failed]:
            print(f"          {failure}", flush=True)
        told = failed


async def sessions_left(running: Services) -> list[str]:
    """Returns a failure unless all sessions can be opened: none was left open."""
    opened: list[str] = []
    try:
        while len(opened) < _SESSIONS:
            opened.append(await sequences.open_session(running, seed=0))
    except Overloaded:
        return [f"sim: {_SESSIONS - len(opened)} of {_SESSIONS} sessions were left open"]
    finally:
        for session in opened:
            await running.sim.close_session(CloseSessionRequest(session))
    return []


def report(findings: Findings) -> int:
    """Prints what was found; returns the exit code."""
    table = Table("service", "calls", "MiB first", "last", "per 10 000", "threads", "descriptors", box=SIMPLE)
    for name, before in findings.before.items():
        some, after = findings.samples[name], findings.after.get(name, before)
        if not some:
            continue
        table.add_row(
            name,
            f"{some[-1].calls:.0f}",
            f"{some[0].rss_mib:.1f}",
            f"{some[-1].rss_mib:.1f}",
            f"{findings.growth(name):+.2f}",
            f"{before.threads} -> {after.threads}",
            f"{before.descriptors} -> {after.descriptors}",
        )
    Console().print(table)
    failures = findings.all_failures()
    for failure in failures[:20]:
        print(failure)
    print(f"{len(failures)} failures.")
    return int(bool(failures))


def main() -> int:
    """Soaks the services; returns 1 when something is wrong."""
    parser = argparse.ArgumentParser(prog="python -m soak", description="Soak all five services under mixed load.")
    parser.add_argument("--minutes", type=float, default=20, help="minutes under load")
    return report(asyncio.run(soak(parser.parse_args().minutes)))


if __name__ == "__main__":
    sys.exit(main())
