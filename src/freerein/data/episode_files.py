"""The data files of a dataset, and the rows of an episode in whichever of them it lies."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cached_property
from pathlib import Path

import pyarrow as pa

from freerein.data import layout
from freerein.data.trajectory_file import episode_ranges, read_rows
from freerein.data.trajectory_part import read_part
from freerein.errors import InvalidInput


class EpisodeFiles:
    """Finds the rows of episodes by their number, in the file that `meta/` names for each.

    Others are searched, if asked for, where that one does not hold the episode, as some converters leave it.
    """

    def __init__(self, root: Path, named: Mapping[int, Path], *, is_searched: bool) -> None:
        self._root = root
        self._named = named
        self._is_searched = is_searched

    def rows(self, episode: int, columns: Sequence[str], *, length: int) -> pa.Table:
        """Returns columns of an episode of so many timesteps; raises InvalidInput where they are not there once."""
        named = self._named[episode]
        try:
            return _whole(read_rows([named], index=episode, columns=columns), length)
        except InvalidInput as error:
            ranges = self._ranges.items() if self._is_searched else ()
            others = [path for path, found in ranges if any(least <= episode <= most for least, most in found)]
            if others in ([], [named]):
                raise
            try:
                return _whole(read_rows(others, index=episode, columns=columns), length)
            except InvalidInput:
                if named.is_file() and not self._ranges.get(named):  # it is damaged
                    raise error from None
                raise

    def part(self, episode: int, column: str, *, timesteps: range, length: int) -> pa.Table:
        """Returns a column of some timesteps of an episode, read no further where the file is as it should be.

        Raises InvalidInput as `rows`.
        """
        with suppress(InvalidInput):  # as `rows` will say
            found = read_part(self._named[episode], column, index=episode, timesteps=timesteps)
            if found is not None:
                return found
        return self.rows(episode, [column], length=length).slice(timesteps.start, len(timesteps))

    def name(self, episode: int) -> str:
        """Returns the name of the file that should hold an episode, for errors."""
        return f"`{self._named[episode].relative_to(self._root).as_posix()}`"

    @property
    def paths(self) -> list[Path]:
        """All data files, in order."""
        return [each.path for each in layout.numbered_files(self._root / "data")]

    @cached_property
    def _ranges(self) -> dict[Path, list[tuple[float, float]]]:
        return {path: episode_ranges(path) for path in self.paths}


def _whole(rows: pa.Table, length: int) -> pa.Table:
    if len(rows) != length:
        raise InvalidInput(
            f"It must have the {length} timesteps that `meta/` names; the data has {len(rows)}.",
            hint="Run `freerein dataset verify`, and restore the broken file from a copy.",
        )
    return rows
