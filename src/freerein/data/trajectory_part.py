"""Some timesteps of a trajectory out of its data file, of which other row groups are not read.

A row group is read as a whole: of one that freerein writes that is little, while frames of a long trajectory may take
gigabytes.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from freerein.data.trajectory_file import EPISODE, ORDER, corrupt_as_invalid, episode_range
from freerein.regular_files import open_regular


def read_part(path: Path, column: str, *, index: int, timesteps: range) -> pa.Table | None:
    """Returns a column of some timesteps of episode `index`, in a file that may hold others.

    None where the file does not have all of them, in the order of their `frame_index`. Raises InvalidInput where it is
    missing or corrupt.
    """
    with corrupt_as_invalid("The data file"), open_regular(path, name=path.name) as file:
        parquet = pq.ParquetFile(file, page_checksum_verification=True)
        order = [ORDER] if ORDER in parquet.schema_arrow.names else []
        parts = list(_parts(parquet, [column, EPISODE, *order], index, timesteps))
        rows = pa.concat_tables(parts).combine_chunks() if parts else None
        if rows is None or len(rows) < len(timesteps):
            return None
        is_in_order = not order or np.array_equal(rows[ORDER].to_numpy(), timesteps)
        return rows.select([column]) if is_in_order else None


def _parts(parquet: pq.ParquetFile, columns: list[str], index: int, timesteps: range) -> Iterator[pa.Table]:
    """Yields the rows of an episode that are these timesteps, where it is in order."""
    seen = 0
    for group in range(parquet.num_row_groups):
        least, greatest = episode_range(parquet, group)
        count = parquet.metadata.row_group(group).num_rows
        if least == index == greatest and seen + count <= timesteps.start:
            seen += count
        elif least <= index <= greatest:
            rows = parquet.read_row_group(group, columns=columns, use_threads=False)
            rows = rows.filter(pc.equal(rows[EPISODE], index))
            start, stop = (min(max(end - seen, 0), len(rows)) for end in (timesteps.start, timesteps.stop))
            yield rows.slice(start, stop - start)
            seen += len(rows)
        if seen >= timesteps.stop:
            return
