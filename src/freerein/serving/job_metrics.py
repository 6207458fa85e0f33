"""Prometheus metrics of what lies in the data directory: fits, runs, and the disk. Read when they are asked for."""

import shutil
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import get_args

from prometheus_client.core import GaugeMetricFamily
from prometheus_client.registry import Collector

from freerein.jobs.json_lines import last_document
from freerein.types.jobs import JobState

_JOB = "[0-9a-f]" * 32


class DataMetrics(Collector):
    """Counts jobs by state; the last event of a job is read again only where its file has grown.

    Attributes:
        data_dir: The data directory; None for no metrics.
        jobs: Folders of jobs by kind, `fit` or `run`.
    """

    def __init__(self) -> None:
        self.data_dir: Path | None = None
        self.jobs: Mapping[str, Path] = {}
        self._read: dict[Path, tuple[int, str, float]] = {}

    def collect(self) -> Iterator[GaugeMetricFamily]:
        """Yields the metrics; without samples where a folder cannot be read."""
        counted = GaugeMetricFamily("freerein_jobs", "Fits or runs.", labels=("kind", "state"))
        changed = GaugeMetricFamily(
            "freerein_running_job_changed_seconds",
            "Unix time of the last event of the running job that changed longest ago.",
            labels=("kind",),
        )
        for kind, folder in self.jobs.items():
            events = self._last_events(folder)
            for state in get_args(JobState):
                counted.add_metric((kind, state), sum(found == state for found, _ in events))
            if times := [time_s for state, time_s in events if state == "running"]:
                changed.add_metric((kind,), min(times))
        yield counted
        yield changed
        yield from self._disk()

    def _last_events(self, folder: Path) -> list[tuple[str, float]]:
        """Returns the state and the Unix time in seconds of the last event of each job that can be read."""
        found: dict[Path, tuple[int, str, float]] = {}
        for path in folder.glob(f"{_JOB}/events.jsonl"):
            with suppress(OSError, ValueError, TypeError):  # deleted meanwhile, or malformed
                size, known = path.stat().st_size, self._read.get(path)
                found[path] = known if known and known[0] == size else (size, *_state_and_time_s(path))
        self._read = {path: each for path, each in self._read.items() if folder not in path.parents} | found
        return [(state, time_s) for _, state, time_s in found.values()]

    def _disk(self) -> Iterator[GaugeMetricFamily]:
        families = (
            GaugeMetricFamily("freerein_data_free_bytes", "Bytes that the disk of the data directory has free."),
            GaugeMetricFamily("freerein_data_size_bytes", "Bytes of the disk of the data directory."),
        )
        with suppress(OSError):
            if self.data_dir is not None:
                disk = shutil.disk_usage(self.data_dir)
                for family, value in zip(families, (disk.free, disk.total), strict=True):
                    family.add_metric((), value)
        yield from families


def _state_and_time_s(path: Path) -> tuple[str, float]:
    event = last_document(path) or {}
    return str(event.get("state")), event.get("time_ns", 0) / 1e9
