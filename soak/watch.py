"""Measurements of running services: memory, threads, file descriptors, calls, and what their logs complain of."""

import math
import re
from dataclasses import dataclass
from pathlib import Path

import httpx
import psutil

from freerein.stack import Stack
from soak.leak import Sample

_MIB = 2**20
_CALLS = re.compile(r"^freerein_calls_total\{.*\} (\S+)$", re.MULTILINE)
_BUSY = re.compile(r"^freerein_(?:calls_in_flight\{.*\}|queued_items) (\S+)$", re.MULTILINE)
_COMPLAINTS = ('"event": "bug"', "Traceback", "never retrieved", "Exception ignored", "was destroyed")


@dataclass(frozen=True)
class Held:
    """The resources of an idle service: threads, file descriptors, and calls in flight or queued."""

    threads: int
    descriptors: int
    busy: float


def processes(stack: Stack) -> dict[str, list[psutil.Process]]:
    """Returns the process of each service and those below it."""
    roots = {status.service: psutil.Process(status.pid) for status in stack.statuses if psutil.pid_exists(status.pid)}
    return {name: [root, *root.children(recursive=True)] for name, root in roots.items()}


async def sample(stack: Stack, client: httpx.AsyncClient, failures: list[str]) -> dict[str, Sample]:
    """Returns the memory of each service, and how many calls it has completed.

    A service whose metrics cannot be read is left out, and added to `failures`.
    """
    rss = {name: sum(map(_rss, found)) / _MIB for name, found in processes(stack).items()}
    calls = {name: await total(name, client, stack.urls[name], _CALLS, failures) for name in rss}
    return {name: Sample(number, rss[name]) for name, number in calls.items() if not math.isnan(number)}


def _rss(process: psutil.Process) -> int:
    """Returns the memory of a process in bytes; 0 where it has just ended, as decoders of videos do."""
    try:
        rss: int = process.memory_info().rss
    except psutil.NoSuchProcess:
        return 0
    return rss


async def held(stack: Stack, client: httpx.AsyncClient, failures: list[str]) -> dict[str, Held]:
    """Returns what each service holds.

    `busy` is NaN for a service whose metrics cannot be read; it is added to `failures`.
    """
    found = {}
    for name, some in processes(stack).items():
        busy = await total(name, client, stack.urls[name], _BUSY, failures)
        found[name] = Held(sum(one.num_threads() for one in some), sum(one.num_fds() for one in some), busy)
    return found


def complaints(logs: Path) -> list[str]:
    """Returns the lines of logs that tell of a bug."""
    lines = [f"{path.stem}: {line}" for path in sorted(logs.iterdir()) for line in path.read_text().splitlines()]
    return [line[:2_000] for line in lines if any(complaint in line for complaint in _COMPLAINTS)]


async def total(name: str, client: httpx.AsyncClient, url: str, pattern: re.Pattern[str], failures: list[str]) -> float:
    """Returns the sum of a service's metrics; NaN where they cannot be read, which is added to `failures`."""
    try:
        reply = (await client.get(f"{url}/metrics")).raise_for_status()
    except httpx.HTTPError as error:
        failures.append(f"{name}: /metrics must be answered with 200; got {error!r}.")
        return math.nan
    return sum(float(number) for number in pattern.findall(reply.text))
