"""The tables in `meta/` of a LeRobotDataset: its episodes and its tasks. Only the columns that are needed are read."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from freerein.data import layout
from freerein.data.trajectory_file import MOST_ROWS, corrupt_as_invalid
from freerein.data.videos import VideoSpan, check_length
from freerein.errors import InvalidInput
from freerein.regular_files import open_regular

_INTEGERS = ("episode_index", "length", "data/chunk_index", "data/file_index")
_LISTS = ("tasks", "skills")
_VIDEO_COLUMNS = {"chunk_index": pa.int64(), "file_index": pa.int64(), "from_timestamp": pa.float64()}
_END_COLUMN = "to_timestamp"
_EPISODES = "`meta/episodes`"


def read_episodes(root: Path, videos: Sequence[str], *, skip_damaged: bool) -> tuple[pa.Table, dict[str, str]]:
    """Returns a row for each episode that `meta/episodes` lists, in the order of their numbers, which may have gaps.

    Args:
        root: The dataset's folder.
        videos: Keys of the cameras whose frames are video.
        skip_damaged: Whether to leave out damaged files.

    Returns:
        The table: int64 `episode_index`, `length`, `data/chunk_index` and `data/file_index`; lists `tasks` and
            `skills`, empty where unknown; and the columns `videos/...` of the cameras that have them.
        Why files were left out, by their names.

    Raises:
        InvalidInput: A file is corrupt, a number is missing or out of range, or an episode is listed twice.
    """
    names = [*_INTEGERS, *_LISTS, *(name for key in videos for name in _video_columns(key))]
    tables, damaged = list[pa.Table](), dict[str, str]()
    for each in layout.numbered_files(root / "meta" / "episodes"):
        try:
            tables.append(read_columns(root, each.path, names))
        except InvalidInput:
            if not skip_damaged:
                raise
            damaged[each.path.relative_to(root).as_posix()] = "damaged, so that its episodes are unknown"
    with corrupt_as_invalid(_EPISODES):
        joined = pa.concat_tables(map(_with_lists, tables), promote_options="permissive").combine_chunks()
        for name in _INTEGERS:
            joined = joined.set_column(joined.schema.get_field_index(name), name, joined[name].cast(pa.int64()))
        joined = joined.sort_by("episode_index")
    _check_numbers(joined)
    return joined, damaged


def read_columns(root: Path, path: Path, names: Sequence[str]) -> pa.Table:
    """Returns those of the columns that a parquet file of a dataset has; all where none is named.

    Raises InvalidInput, with the name of the file, where it is missing or corrupt, or has too many rows.
    """
    file = path.relative_to(root).as_posix()
    with corrupt_as_invalid(f"`{file}`"), open_regular(path, name=file) as opened:
        parquet = pq.ParquetFile(opened)
        if parquet.metadata.num_rows > MOST_ROWS:
            raise ValueError("too many rows")
        columns = parquet.schema_arrow.names
        present = [name for name in names if name in columns] if names else columns
        return parquet.read(columns=present, use_threads=False).select(present)


def with_column(table: pa.Table, name: str, values: pa.Array) -> pa.Table:
    """Returns a table with a column, in place of another one of its name."""
    place = table.schema.get_field_index(name)
    return table.append_column(name, values) if place < 0 else table.set_column(place, name, values)


def has_video(episodes: pa.Table, key: str) -> bool:
    """Returns whether the table says where the frames of a camera lie."""
    return set(_video_columns(key)) <= set(episodes.column_names)


def contradicting(root: Path, episodes: pa.Table, key: str, *, fps: int) -> set[int]:
    """Returns the numbers of the episodes that last otherwise in the video of a camera than in timesteps."""
    found = set[int]()
    for row, number in enumerate(episodes["episode_index"].to_pylist()):
        try:
            video_spans(root, episodes.slice(row, 1), key, fps=fps)
        except InvalidInput:
            found.add(number)
    return found


def video_spans(root: Path, episodes: pa.Table, key: str, *, fps: int) -> tuple[VideoSpan, ...]:
    """Returns where the frames of each episode lie, by its own row of the table."""
    with corrupt_as_invalid(_EPISODES):
        kinds = [*_VIDEO_COLUMNS.values(), pa.float64()]
        columns = [episodes[name].cast(kind) for name, kind in zip(_video_columns(key), kinds, strict=True)]
        rows = list(zip(*(each.to_pylist() for each in columns), strict=True))
        files = [layout.VIDEO_PATH.format(video_key=key, chunk_index=row[0], file_index=row[1]) for row in rows]
        lengths = episodes["length"].to_pylist()
        spans = [VideoSpan(root, file, row[2], each) for file, row, each in zip(files, rows, lengths, strict=True)]
        numbers = episodes["episode_index"].to_pylist()
        return tuple(
            check_length(span, row[3], index=number, fps=fps)
            for number, span, row in zip(numbers, spans, rows, strict=True)
        )


def read_texts(root: Path, file: str, noun: str) -> dict[int, str]:
    """Returns the texts of `tasks.parquet`, or of a table like it, by their index.

    `noun` is the name of the column of the texts, and of that of their indices before `_index`.
    """
    table = read_columns(root, root / file, ())
    named = [name for name in table.column_names if name == noun] or table.column_names
    texts = next((table[name] for name in named if is_text(table[name].type)), None)
    if texts is None:
        raise InvalidInput(
            f"`{Path(file).name}` must have the texts of the {noun}s in a column `{noun}`; it has no such texts.",
            hint="Write it again with LeRobot.",
        )
    with corrupt_as_invalid(f"`{Path(file).name}`"):
        key = f"{noun}_index"
        indices = table[key].cast(pa.int64()).to_pylist() if key in table.column_names else range(len(table))
        return {int(index): str(text or "") for index, text in zip(indices, texts.to_pylist(), strict=True)}


def is_text(kind: pa.DataType) -> bool:
    """Returns whether a column holds texts, in whichever way: pandas, since version 3, has others than before."""
    values = kind.value_type if pa.types.is_dictionary(kind) else kind
    return values in (pa.string(), pa.large_string(), pa.string_view())


def _video_columns(key: str) -> list[str]:
    return [f"videos/{key}/{name}" for name in (*_VIDEO_COLUMNS, _END_COLUMN)]


def _with_lists(table: pa.Table) -> pa.Table:
    """Returns a table whose tasks and skills are lists of texts, empty where they are missing."""
    strings = pa.list_(pa.string())
    for name in _LISTS:
        lists = table[name].to_pylist() if name in table.column_names else [None] * len(table)
        table = table.drop_columns([name] if name in table.column_names else [])
        texts = [[text for text in each or () if text is not None] for each in lists]
        table = table.append_column(name, pa.array(texts, strings))
    return table


def _check_numbers(episodes: pa.Table) -> None:
    """Raises InvalidInput where a number is missing, negative or too large, or an episode is listed twice."""
    for name in _INTEGERS:
        column = episodes[name]
        values = np.array([] if column.null_count else column.to_numpy(), np.int64)
        if len(values) != len(column) or np.any((values < 0) | (values > MOST_ROWS)):
            raise InvalidInput(
                f"{_EPISODES} must have a `{name}` of 0 to {MOST_ROWS} in each row; some are missing, or others.",
                hint="Write the table again with LeRobot.",
            )
    numbers = episodes["episode_index"].to_numpy()
    twice = numbers[1:][numbers[1:] == numbers[:-1]]
    if len(twice):
        raise InvalidInput(
            f"{_EPISODES} must list each episode once; it lists episode {twice[0]} again.",
            hint="Delete one of the rows: they may name different data.",
        )
