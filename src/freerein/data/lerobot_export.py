"""Exports the labels of a dataset to the LeRobotDataset v3 that it was imported from, in LeRobot's own columns.

    data/                            `language_persistent`: rows of style `subtask`, as of version 3.1
    meta/episodes/                   the stages of SARM; see `freerein.data.sarm_stages`
    meta/info.json                   the feature
    meta/temporal_proportions_*      shares of the stages

All else stays as it is, bit for bit; an export that was cut short is completed by the next one.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from freerein.data import language_rows, layout, lerobot, lerobot_features, lerobot_tables, meta, sarm_stages
from freerein.data.folder_locks import unused
from freerein.data.label_segments import read_label_segments
from freerein.data.language_rows import Subtasks
from freerein.data.reader import Dataset
from freerein.data.staged_files import staged_files
from freerein.data.trajectory_file import corrupt_as_invalid
from freerein.errors import AlreadyExists, FailedPrecondition, InvalidInput, NotFound, quoted
from freerein.regular_files import open_regular
from freerein.types.orchestrator import LabelSegment

_HINT = "Name the folder that the dataset was imported from, as it was then."
_ROUNDING_S = 1e-3


def export_labels(root: Path, original: Path, *, replaces: bool = False) -> int:
    """Writes the predicted labels of a dataset into the LeRobotDataset that it was imported from.

    Args:
        root: The dataset's folder.
        original: The other one's; its episodes, in the order of their numbers, are the dataset's trajectories.
        replaces: Whether other subtasks and stages that are there already are replaced.

    Returns:
        The number of episodes.

    Raises:
        FailedPrecondition: The dataset was not labelled, or another export is at work.
        NotFound: There is no LeRobotDataset v3.
        InvalidInput: It is another dataset, corrupt, or one of freerein's own.
        AlreadyExists: It has other subtasks or stages.
    """
    dataset = Dataset(root)
    segments = read_label_segments(root, dataset)
    _check_is_foreign(original)
    for _ in unused([original]):  # one export at a time
        plan = _plan(original, dataset, segments)
        if not replaces:
            _check_no_others(plan)
        _write(plan)
        return len(segments)
    raise FailedPrecondition(
        "The original must be written by one export at a time; another one is writing.", hint="Wait for its end."
    )


@dataclass(frozen=True)
class _Plan:
    """The labels that are written to a dataset: the segments of each episode, and its subtasks, by `episode_index`."""

    original: Path
    info: Mapping[str, Any]
    segments: dict[int, list[LabelSegment]]
    subtasks: Subtasks
    data: list[Path]
    episodes: list[Path]


def _plan(original: Path, dataset: Dataset, segments: list[list[LabelSegment]]) -> _Plan:
    """Returns what is to be written; raises InvalidInput where episodes and data files are not those of the dataset."""
    info = lerobot.read_info(original)
    lerobot_features.described(info.get("features"))
    fps = lerobot.fps_of(info)
    episodes = lerobot_tables.read_episodes(original, [], skip_damaged=False)[0]
    lengths = dict(zip(episodes["episode_index"].to_pylist(), episodes["length"].to_pylist(), strict=True))
    _check_same(dataset, lengths, fps)
    of_episodes = dict(zip(lengths, segments, strict=True))
    data = [each.path for each in layout.numbered_files(original / "data")]
    starts = {number: times for number, times in _times(original, data, fps) if number in lengths}
    for number, length in lengths.items():
        if (found := len(starts.get(number, ()))) != length:
            raise InvalidInput(
                f"Episode {number} must have {length} timesteps in the data files; it has {found}.",
                hint="`freerein dataset verify FOLDER` lists what is damaged.",
            )
    subtasks = {number: _subtasks(some, starts[number]) for number, some in of_episodes.items()}
    tables = [each.path for each in layout.numbered_files(original / "meta" / "episodes")]
    return _Plan(original, info, of_episodes, subtasks, data, tables)


def _check_is_foreign(original: Path) -> None:
    """Raises NotFound or InvalidInput where a folder holds no dataset of another tool."""
    if not (original / layout.INFO_FILE).is_file():
        raise NotFound(
            f"There must be a LeRobotDataset v3 in the folder; {quoted(str(original))} has no `{layout.INFO_FILE}`.",
            hint=_HINT,
        )
    if meta.read_spec(original) is not None:
        raise InvalidInput(
            "The original must be a dataset of another tool; this one is freerein's, with its labels in `labels/`.",
            field="lerobot",
            hint=_HINT,
        )


def _check_same(dataset: Dataset, lengths: dict[int, int], fps: int) -> None:
    """Raises InvalidInput where episodes are not the trajectories of a dataset."""
    if len(lengths) != len(dataset):
        sentence = f"must have the {len(dataset)} episodes of the dataset; it has {len(lengths)}"
    elif fps != dataset.spec.fps:
        sentence = f"must have {dataset.spec.fps} timesteps per second, as the dataset; it has {fps}"
    else:
        pairs = zip(lengths.items(), dataset.lengths.tolist(), strict=True)
        wrong = [(number, length, expected) for (number, length), expected in pairs if length != expected]
        if not wrong:
            return
        number, length, expected = wrong[0]
        sentence = f"must have {expected} timesteps in episode {number}, as the dataset; it has {length}"
    raise InvalidInput(f"The original {sentence}.", field="lerobot", hint=_HINT)


def _times(original: Path, files: Sequence[Path], fps: int) -> Iterator[tuple[int, npt.NDArray[np.float64]]]:
    """Yields each episode and when its timesteps are, float64 (T,), in seconds; data files may share an episode."""
    columns = ["episode_index", "frame_index", "timestamp"]
    tables = [lerobot_tables.read_columns(original, path, columns) for path in files]
    with corrupt_as_invalid("`data`"):
        rows = pa.concat_tables(tables, promote_options="permissive")
        numbers = rows["episode_index"].to_numpy()
        steps = rows["frame_index"].to_numpy() if "frame_index" in rows.column_names else np.arange(len(rows))
        order = np.lexsort((steps, numbers))
        own = rows["timestamp"].to_numpy().astype(np.float64) if "timestamp" in rows.column_names else None
        found, firsts = np.unique(numbers[order], return_index=True)
        for number, part in zip(found.tolist(), np.split(order, firsts[1:]), strict=True):
            times = np.arange(len(part)) / fps if own is None else own[part]
            if not np.all(np.isfinite(times)):
                raise InvalidInput(
                    f"Each `timestamp` of episode {number} must be a finite number; some are missing or not finite.",
                    hint="Write the dataset again with LeRobot.",
                )
            yield number, times


def _subtasks(segments: list[LabelSegment], times: npt.NDArray[np.float64]) -> list[tuple[float, str]]:
    """Returns when each skill begins; where none follows, an empty text ends it."""
    leads = segments[1:] if segments and not segments[0].skill else segments
    return [(float(times[each.start]), each.skill) for each in leads]


def _check_no_others(plan: _Plan) -> None:
    """Raises AlreadyExists where the original has subtasks or stages that are not those to be written."""
    for path in plan.data:
        rows = lerobot_tables.read_columns(plan.original, path, ["episode_index", language_rows.COLUMN])
        for number, time_s, text in language_rows.subtasks_of(rows):
            ours = plan.subtasks.get(number, ())
            if not any(abs(time_s - begins) < _ROUNDING_S and text == skill for begins, skill in ours):
                raise _others(f"`{language_rows.COLUMN}` of episode {number}")
    for path in plan.episodes:
        rows = lerobot_tables.read_columns(plan.original, path, ())
        name = sarm_stages.other_stages(rows, plan.segments, fps=lerobot.fps_of(plan.info))
        if name:
            raise _others(f"`{name}`")


def _others(where: str) -> AlreadyExists:
    return AlreadyExists(
        f"The original must have no subtasks other than the dataset's labels; {where} has some.",
        field="lerobot",
        hint="Keep a copy of it if people made them; --replace replaces them.",
    )


def _write(plan: _Plan) -> None:
    meta_folder, info, fps = plan.original / "meta", plan.info, lerobot.fps_of(plan.info)
    shares = json.dumps(sarm_stages.proportions(plan.segments), indent=2).encode()
    with staged_files() as stage:
        for path in plan.data:
            _rewrite(path, stage(path), lambda rows: language_rows.with_subtasks(rows, plan.subtasks))
        for path in plan.episodes:
            _rewrite(path, stage(path), lambda rows: sarm_stages.with_stages(rows, plan.segments, fps=fps))
        for granularity in sarm_stages.GRANULARITIES:
            stage(meta_folder / f"temporal_proportions_{granularity}.json").write_bytes(shares)
        if language_rows.COLUMN not in info["features"]:
            features = {**info["features"], language_rows.COLUMN: language_rows.FEATURE}
            text = json.dumps({**info, "features": features}, indent=4, ensure_ascii=False)
            stage(plan.original / layout.INFO_FILE).write_text(text, encoding="utf-8")


def _rewrite(path: Path, new: Path, change: Callable[[pa.Table], pa.Table]) -> None:
    """Writes a parquet file with changed columns, a row group at a time, as LeRobot has one for each episode."""
    with open_regular(path, name=path.name) as file:
        with corrupt_as_invalid(f"`{path.name}`"):
            parquet = pq.ParquetFile(file)
            groups = range(parquet.num_row_groups)
            kind = parquet.metadata.row_group(0).column(0).compression if groups else "SNAPPY"
            schema = change(parquet.read_row_group(0) if groups else parquet.schema_arrow.empty_table()).schema
        with pq.ParquetWriter(new, schema, compression="none" if kind == "UNCOMPRESSED" else kind) as writer:
            for group in groups:
                with corrupt_as_invalid(f"`{path.name}`"):
                    rows = change(parquet.read_row_group(group, use_threads=False))
                writer.write_table(rows, row_group_size=max(1, len(rows)))
