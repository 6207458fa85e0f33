"""`metrics.jsonl`: one row of metrics per logged step, written by a job's child process."""

import errno
import json
import math
import os
from collections.abc import Iterable, Iterator, Mapping
from itertools import groupby, islice, product
from pathlib import Path
from typing import Any, BinaryIO

from freerein.atomic_files import write_atomic
from freerein.types.jobs import JobMetrics, MetricRow


class MetricsWriter:
    """Writes rows `{"step": ..., <metric>: <number>, ...}` in order of steps, without gaps or repeats after a crash.

    A job resumes from `last_step`: later rows are dropped, for they will be written again.
    """

    def __init__(self, path: Path, *, last_step: int) -> None:
        self._path = path
        lines = path.read_bytes().splitlines(keepends=True) if path.is_file() else []
        kept = (line for line in lines if line.endswith(b"\n") and json.loads(line)["step"] <= last_step)
        write_atomic(path, b"".join(kept))

    def append(self, step: int, metrics: Mapping[str, float]) -> None:
        """Appends a row, whole or not at all. Raises OSError when the disk is full or broken."""
        row = json.dumps({"step": step, **metrics}).encode() + b"\n"
        with self._path.open("ab", buffering=0) as file:
            end = file.seek(0, os.SEEK_END)
            if file.write(row) != len(row):
                file.truncate(end)
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def sync(self) -> None:
        """Makes the rows durable, before a checkpoint that counts them. Raises OSError when the disk is broken."""
        with self._path.open("rb") as file:
            os.fsync(file.fileno())


def read_metrics(path: Path, *, from_step: int, max_rows: int, keep_extremes: bool = False) -> JobMetrics:
    """Returns at most `max_rows` rows from a step on, with the first and the last; of more rows those that count.

    These are evenly spaced; with `keep_extremes`, and room for two rows of each metric, the extremes of each metric.
    Values that are not finite are left out; the file may not exist yet.
    """
    if not path.is_file():
        return JobMetrics((), 0, from_step)
    with path.open("rb") as file:  # twice through the file, so that memory is bounded
        total, names = 0, set[str]()
        for document in _documents(file, from_step):
            total += 1
            names.update(document)
        file.seek(0)
        found = map(metric_row, islice(_documents(file, from_step), total))
        buckets = (max_rows - 2) // (2 * max(1, len(names) - 1))
        if keep_extremes and total > max_rows and buckets > 0:
            rows = tuple(_extremes(found, total, buckets))
        else:
            rows = tuple(_evenly(found, total, min(total, max_rows)))
    return JobMetrics(rows, total, rows[-1].step + 1 if rows else from_step)


def _evenly(rows: Iterable[MetricRow], total: int, count: int) -> Iterator[MetricRow]:
    """Yields `count` of so many rows."""
    kept = {total - 1 - index * (total - 1) // max(1, count - 1) for index in range(count)}
    return (row for index, row in enumerate(rows) if index in kept)


def _extremes(rows: Iterable[MetricRow], total: int, buckets: int) -> Iterator[MetricRow]:
    """Yields the first and the last of so many rows, and those of each bucket in which a metric is least or greatest.

    A curve through them differs from that of all rows by less than the width of a bucket.
    """
    for _, bucket in groupby(enumerate(rows), lambda each: each[0] * buckets // total):
        kept, best = dict[int, MetricRow](), dict[tuple[str, int], tuple[float, int, MetricRow]]()
        for index, row in bucket:
            if index in (0, total - 1):
                kept[index] = row
            for (name, value), sign in product(row.metrics.items(), (-1, 1)):
                if (name, sign) not in best or sign * value > best[name, sign][0]:
                    best[name, sign] = (sign * value, index, row)
        kept |= {index: row for _, index, row in best.values()}
        yield from (kept[index] for index in sorted(kept))


def metric_row(document: Mapping[str, Any]) -> MetricRow:
    """Returns a row of the file without its non-finite values."""
    numbers = {name: value for name, value in document.items() if name != "step" and isinstance(value, int | float)}
    return MetricRow(document["step"], {name: float(each) for name, each in numbers.items() if math.isfinite(each)})


def _documents(file: BinaryIO, from_step: int) -> Iterator[dict[str, Any]]:
    for line in file:
        if line.endswith(b"\n") and (document := json.loads(line))["step"] >= from_step:
            yield document
