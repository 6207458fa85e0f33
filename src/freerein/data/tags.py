"""Tags that trajectories were given after recording: `tags.json`, which replaces those of the data files."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from freerein.atomic_files import write_atomic
from freerein.data import json_files
from freerein.errors import InvalidInput, quoted

_FILE = "tags.json"


@dataclass(frozen=True)
class Tags:
    """Tags of some trajectories of a dataset.

    Attributes:
        skills: Skill names of the whole dataset; labels are indices into them.
        by_trajectory: The skills that occur, sorted, by `episode_index`; the others keep those of their files.
    """

    skills: tuple[str, ...]
    by_trajectory: Mapping[int, tuple[str, ...]]

    def applied(self, episodes: Sequence[int], recorded: Sequence[Sequence[str]]) -> list[list[str]]:
        """Returns the skills of every trajectory, given their `episode_index` and the skills of the data files."""
        return [list(self.by_trajectory.get(*each)) for each in zip(episodes, recorded, strict=True)]

    @property
    def sha256(self) -> str:
        """The sha256 of the tags, in hexadecimal."""
        return hashlib.sha256(_dumps(self)).hexdigest()


def read(root: Path) -> Tags | None:
    """Returns the tags beside a dataset; None where none were given.

    Raises:
        InvalidInput: The file is corrupt.
    """
    path = root / _FILE
    if not path.is_file():
        return None
    try:
        document = json_files.read(path, name=_FILE)
        tagged = {int(index): tuple(map(str, skills)) for index, skills in document["by_trajectory"].items()}
        return Tags(tuple(map(str, document["skills"])), tagged)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InvalidInput(
            f"`tags.json` must hold the tags as freerein wrote them; reading it failed: {quoted(repr(error))}.",
            hint="Delete it, then tag the dataset again: freerein dataset tag NAME tags.csv.",
        ) from None


def save(root: Path, tags: Tags) -> None:
    """Writes the tags of a dataset durably, all of them or none."""
    write_atomic(root / _FILE, _dumps(tags))


def _dumps(tags: Tags) -> bytes:
    by_trajectory = {str(index): list(skills) for index, skills in sorted(tags.by_trajectory.items())}
    return json.dumps({"skills": list(tags.skills), "by_trajectory": by_trajectory}, indent=1).encode() + b"\n"
