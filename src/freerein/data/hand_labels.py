"""Labels of trajectories that a person gave, beside a dataset. No fit reads them, and nothing is measured by them.

    <root>/hand_labels/000012.json    segments of the trajectory with `episode_index` 12, by the names of their skills

True labels are another thing, and lie elsewhere; this module does not know where.
"""

import json
from collections.abc import Collection, Sequence
from contextlib import closing
from dataclasses import asdict
from pathlib import Path

from freerein.atomic_files import write_atomic
from freerein.data import json_files
from freerein.data.meta import WriterLock
from freerein.data.reader import Dataset
from freerein.errors import FailedPrecondition, InvalidInput, must_be, quoted
from freerein.types.orchestrator import LabelSegment
from freerein.unknown_names import described, listed

_FOLDER = "hand_labels"
_HINT = "Save the labels of this trajectory again, or delete the file."


def check_none(root: Path) -> None:
    """Raises FailedPrecondition where a person has labelled a trajectory of a dataset, which nobody else has."""
    if count(root):
        raise FailedPrecondition(
            "A dataset that is replaced must have no labels that a person gave; this one has some.",
            field="dataset",
            hint="Choose another name, or give them up with it: `freerein dataset rm NAME`.",
        )


def save(root: Path, index: int, segments: Sequence[LabelSegment], *, known: Collection[str]) -> None:
    """Writes the labels of a trajectory durably, in place of those that a person gave before.

    Args:
        root: The dataset's folder.
        index: Index of the trajectory.
        segments: In order, from timestep 0 to the last; the skill is empty where there is none.
        known: Names that a skill may have.

    Raises:
        IndexError: There is no such trajectory.
        InvalidInput: Segments overlap or leave a gap, or have an unknown skill.
        FailedPrecondition: The dataset is being written.
    """
    with closing(WriterLock(root)):
        dataset = Dataset(root)
        check_segments(segments, timesteps=int(dataset.lengths[index]), known=known)
        document = {"segments": [asdict(each) for each in segments]}
        write_atomic(_path(root, dataset, index), json.dumps(document, indent=1).encode() + b"\n")


def read(root: Path, dataset: Dataset, index: int) -> tuple[LabelSegment, ...]:
    """Returns the labels of a trajectory that a person gave, without gaps; empty where none did.

    Raises InvalidInput where they are corrupt, or not of a trajectory of this length.
    """
    path = _path(root, dataset, index)
    if not path.is_file():
        return ()
    try:
        document = json_files.read(path, name=path.name)
        segments = [
            LabelSegment(int(each["start"]), int(each["end"]), str(each["skill"])) for each in document["segments"]
        ]
        check_segments(segments, timesteps=int(dataset.lengths[index]), known={each.skill for each in segments})
    except (ValueError, KeyError, TypeError, InvalidInput) as error:
        raise InvalidInput(
            f"`{_FOLDER}/{path.name}` must hold labels of the whole trajectory as freerein wrote them; reading it "
            f"failed: {quoted(repr(error))}.",
            hint=_HINT,
        ) from None
    return tuple(segments)


def count(root: Path) -> int:
    """Returns how many trajectories have labels that a person gave."""
    return sum(1 for _ in (root / _FOLDER).glob("[0-9]*.json"))


def check_segments(segments: Sequence[LabelSegment], *, timesteps: int, known: Collection[str]) -> None:
    """Raises InvalidInput unless segments cover [0, timesteps) in order, with skills that are known, or none."""
    end = 0
    for number, each in enumerate(segments):
        if each.start != end:
            rule = f"{end}, where the segment before ends" if number else "0"
            hint = "Segments are [start, end), in order, without gap or overlap; where there is no skill it is empty."
            raise must_be(f"segments.{number}.start", rule, each.start, hint=hint)
        if not each.start < each.end <= timesteps:
            hint = "A segment has at least one timestep, and ends with the trajectory at the latest."
            raise must_be(f"segments.{number}.end", f"above {each.start} and at most {timesteps}", each.end, hint=hint)
        if each.skill and each.skill not in known:
            raise InvalidInput(
                f"The skill must be one of the dataset, or of the model that labelled it; got "
                f"{described(each.skill, sorted(known))}",
                field=f"segments.{number}.skill",
                hint=f"There are {listed(sorted(known)) or 'none'}.",
            )
        end = each.end
    if end != timesteps:
        raise InvalidInput(
            f"The segments must end with the trajectory, at {timesteps}; they end at {end}.",
            field="segments",
            hint="Give the rest a segment, too, without a skill where there is none.",
        )


def _path(root: Path, dataset: Dataset, index: int) -> Path:
    return root / _FOLDER / f"{dataset.episodes[index]:06d}.json"
