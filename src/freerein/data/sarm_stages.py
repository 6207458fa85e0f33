"""The columns of `meta/episodes` from which LeRobot's SARM, a model of progress, reads the stages of each episode.

SARM has sparse and dense stages, and no mode for sparse ones alone; both are the skills here. Stages are ordered as
skills follow each other on average: SARM takes the later ones for more progress.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence

import numpy as np
import pyarrow as pa

from freerein.data.lerobot_tables import with_column
from freerein.types.orchestrator import LabelSegment

GRANULARITIES = ("sparse", "dense")
_TEXTS, _TIMES, _FRAMES = pa.list_(pa.string()), pa.list_(pa.float64()), pa.list_(pa.int64())

Segments = Mapping[int, Sequence[LabelSegment]]
"""The segments of each episode, by `episode_index`."""


def proportions(segments: Segments) -> dict[str, float]:
    """Returns the share of each skill, averaged over the episodes in which it occurs, of 1 in all; in their order."""
    shares, middles = defaultdict[str, list[float]](list), defaultdict[str, list[float]](list)
    for some in segments.values():
        durations = defaultdict[str, int](int)
        for each in (each for each in some if each.skill):
            durations[each.skill] += each.end - each.start
            middles[each.skill].append((each.start + each.end) / 2 / some[-1].end)
        for skill, duration in durations.items():
            shares[skill].append(duration / sum(durations.values()))
    means = {skill: float(np.mean(shares[skill])) for skill in sorted(shares, key=lambda name: np.mean(middles[name]))}
    return {skill: mean / sum(means.values()) for skill, mean in means.items()}


def with_stages(episodes: pa.Table, segments: Segments, *, fps: int) -> pa.Table:
    """Returns rows of `meta/episodes` with the stages of each episode; columns of these names are replaced.

    Frames are the first and the last one of a stage, as SARM reads them; a stage ends, in seconds, where the next
    begins.
    """
    numbers = episodes["episode_index"].to_pylist()
    stages = [[each for each in segments.get(number, ()) if each.skill] for number in numbers]
    columns = {
        "subtask_names": ([[each.skill for each in some] for some in stages], _TEXTS),
        "subtask_start_times": ([[each.start / fps for each in some] for some in stages], _TIMES),
        "subtask_end_times": ([[each.end / fps for each in some] for some in stages], _TIMES),
        "subtask_start_frames": ([[each.start for each in some] for some in stages], _FRAMES),
        "subtask_end_frames": ([[each.end - 1 for each in some] for some in stages], _FRAMES),
    }
    for name, (values, kind) in columns.items():
        for granularity in GRANULARITIES:
            episodes = with_column(episodes, f"{granularity}_{name}", pa.array(values, kind))
    return episodes


def other_stages(episodes: pa.Table, segments: Segments, *, fps: int) -> str:
    """Returns a column of stages in rows of `meta/episodes` that are not those of the segments; empty without."""
    ours = with_stages(episodes.select(["episode_index"]), segments, fps=fps)
    names: list[str] = [name for name in ours.column_names[1:] if name in episodes.column_names]
    for name in names:
        pairs = zip(episodes[name].to_pylist(), ours[name].to_pylist(), strict=True)
        if any(theirs and theirs != own for theirs, own in pairs):
            return name
    return ""
