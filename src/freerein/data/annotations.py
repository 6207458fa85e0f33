"""Annotations that people bring as tables: tags of trajectories, and true labels of a few for evaluation.

    trajectory,skills            trajectory,start,end,skill
    0,reach;pour                 0,0,41,reach
    1,reach;stir                 0,41,90,pour

A trajectory is named by its index, LeRobot's `episode_index`. Nothing changes unless the whole file is valid.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from pathlib import Path

import numpy as np
import numpy.typing as npt

from freerein.data import meta, tags, truth
from freerein.data.annotation_table import Line, lines
from freerein.data.label_table import LabelOptions, Segment, read_segments
from freerein.data.meta import WriterLock
from freerein.data.reader import Dataset
from freerein.data.skill_names import SkillNames, normal
from freerein.data.tags import Tags
from freerein.errors import FailedPrecondition, quoted
from freerein.types.segmentation import NO_SKILL

_TAG_COLUMNS = ("trajectory", "skills")
_NAMED_TWICE = ("name each trajectory once; it names one again", "Join the two lines.")
_SEVERAL_HINT = "Separate skills by `;`, such as reach;pour."
_OF_TABLE = LabelOptions()


def tag(root: Path, table: bytes, *, on_note: Callable[[str], None] = lambda _: None) -> int:
    """Tags trajectories of a dataset with the skills that occur in them; returns how many.

    An empty cell takes the tags away. The dataset's skills are afterwards those of its trajectories; while some have
    true labels, which are indices into them, no skill is removed.

    Args:
        root: The dataset's folder.
        table: CSV with the columns `trajectory` and `skills`, several separated by semicolons; other trajectories
            keep their tags. Skills that differ by capital letters or spaces are one.
        on_note: Called with a sentence for each spelling that was taken for another.

    Raises:
        NotFound: There is no dataset in `root`.
        InvalidInput: A line is not as above; the error names line and column.
        FailedPrecondition: The dataset is being written.
    """
    Dataset(root)  # where there is none, no lock is made
    with closing(WriterLock(root)):
        dataset = Dataset(root)
        given = _tags(table, dataset, SkillNames(dataset.spec.skills, on_note))
        _save_tags(root, dataset, given)
    return len(given)


def label(
    root: Path,
    table: bytes,
    *,
    options: LabelOptions = _OF_TABLE,
    with_tags: bool = False,
    on_note: Callable[[str], None] = lambda _: None,
) -> int:
    """Stores true labels of a few trajectories, for evaluation only; returns of how many.

    Args:
        root: The dataset's folder.
        table: Segments [start, end) of skills, or a skill for each timestep, as `read_segments` takes them. Timesteps
            in none of them have no label.
        options: How to read it.
        with_tags: Whether the skills of its labels become tags of a trajectory, beside those that it has.
        on_note: Called with a sentence for each spelling or unit that was taken for another, and for timesteps without
            a label.

    Raises:
        NotFound: There is no dataset in `root`.
        InvalidInput: A line is not as above, overlaps another, or has a skill that is not among the trajectory's tags;
            the error names line and column.
        FailedPrecondition: The dataset is being written, or another tool wrote it.
    """
    Dataset(root)  # where there is none, no lock is made
    with closing(WriterLock(root)):
        dataset = Dataset(root)
        if meta.read_spec(root) is None:
            raise FailedPrecondition(
                "True labels must belong to a dataset that freerein wrote; another tool wrote this one.",
                hint="Import it first: freerein dataset import PATH NAME.",
            )
        lengths = dataset.lengths.tolist()
        segments = read_segments(table, lengths, fps=dataset.spec.fps, options=options, on_note=on_note)
        names = _label_names(segments, dataset, SkillNames(dataset.spec.skills, on_note), with_tags=with_tags)
        spellings = sorted(set(names.values()))
        labels = _labels(segments, [spellings.index(names[each.skill]) for each in segments], lengths)
        if with_tags:
            _save_tags(root, dataset, _tags_of(segments, names, dataset))
        skills = Dataset(root).spec.skills
        numbers = np.array([*map(skills.index, spellings), NO_SKILL], np.int64)
        for index, values in labels.items():
            truth.save(root, index, numbers[values])
            if missing := int(np.sum(values == NO_SKILL)):
                which = f"{missing} of {len(values)} timesteps of trajectory {index}"
                on_note(f"{which} have no label: they are not measured.")
    return len(labels)


def read_tags(
    table: bytes, names: Sequence[str], *, known: Iterable[str] = (), on_note: Callable[[str], None] = lambda _: None
) -> dict[str, tuple[str, ...]]:
    """Returns the skills of trajectories by name, as `tag` reads those by index; `known` are skills that there are.

    Raises InvalidInput where a line is not as there, or names none of the trajectories `names`.
    """
    skills, by_name = SkillNames(known, on_note), {normal(name): name for name in names}
    given = dict[str, tuple[str, ...]]()
    for line in lines(table, _TAG_COLUMNS, hint=_SEVERAL_HINT):
        name = by_name.get(normal(line.cells["trajectory"]))
        if name is None:
            rule = f"name a trajectory that is there; got {quoted(line.cells['trajectory'])}"
            raise line.error("trajectory", rule, f"The first is {names[0]}.")
        if name in given:
            raise line.error("trajectory", *_NAMED_TWICE)
        given[name] = _skills(line, skills)
    return given


def _skills(line: Line, skills: SkillNames) -> tuple[str, ...]:
    """Returns the skills that the column `skills` names, sorted; empty for an empty cell."""
    try:
        return tuple(sorted(set(skills.split(line.cells["skills"]))))
    except ValueError as error:
        raise line.error("skills", str(error), "For example: reach;pour.") from None


def _tags(table: bytes, dataset: Dataset, skills: SkillNames) -> dict[int, tuple[str, ...]]:
    """Returns the skills of the trajectories named, by LeRobot's `episode_index`."""
    given, known = dict[int, tuple[str, ...]](), frozenset(dataset.episodes)
    for line in lines(table, _TAG_COLUMNS, hint=_SEVERAL_HINT):
        episode = line.integer("trajectory", least=0, most=max(known, default=0))
        if episode not in known:
            raise line.error("trajectory", f"name an episode that is there; got {episode}", "Leave the line out.")
        if episode in given:
            raise line.error("trajectory", *_NAMED_TWICE)
        given[episode] = _skills(line, skills)
    return given


def _save_tags(root: Path, dataset: Dataset, given: Mapping[int, tuple[str, ...]]) -> None:
    earlier = tags.read(root)
    merged = {**(earlier.by_trajectory if earlier else {}), **given}
    pairs = zip(dataset.episodes, dataset.skills, strict=True)
    occurring = {skill for episode, skills in pairs for skill in given.get(episode, skills)}
    kept = [skill for skill in dataset.spec.skills if skill in occurring or truth.labelled(root)]
    tags.save(root, Tags((*kept, *sorted(occurring - set(kept))), merged))
    spec = meta.read_spec(root)
    if spec is not None:
        meta.save(root, spec, meta.load(root, spec)[0])


def _label_names(
    segments: Sequence[Segment], dataset: Dataset, skills: SkillNames, *, with_tags: bool
) -> dict[str, str]:
    """Returns the spelling of each skill that the table has."""
    names = dict[str, str]()
    for each in segments:
        column = each.columns[1]
        try:
            name = names.setdefault(each.skill, skills.one(each.skill))
        except ValueError as error:
            raise each.line.error(column, str(error), "A label is one skill.") from None
        tagged = dataset.skills[each.trajectory] or dataset.spec.skills
        if not with_tags and name not in tagged:
            is_tagged = bool(dataset.skills[each.trajectory])
            known = f"the tags of trajectory {each.trajectory}" if is_tagged else "the dataset's skills"
            expected = f"be among {known}, {', '.join(tagged) or 'none yet'}; got {quoted(name)}"
            hint = "Tag the dataset first, or take the tags from the labels: --tags."
            raise each.line.error(column, expected, hint)
    return names


def _labels(
    segments: Sequence[Segment], numbers: Sequence[int], lengths: Sequence[int]
) -> dict[int, npt.NDArray[np.int64]]:
    """Returns the number of the segment of each timestep by trajectory, int64 (T,); `NO_SKILL` where there is none."""
    labels = {each.trajectory: np.full(lengths[each.trajectory], NO_SKILL, np.int64) for each in segments}
    for each, number in zip(segments, numbers, strict=True):
        values = labels[each.trajectory][each.start : each.end]
        if np.any(values != NO_SKILL):
            expected = "begin where no other segment is; it overlaps one"
            raise each.line.error(each.columns[0], expected, "Segments are [start, end).")
        values[:] = number
    return labels


def _tags_of(segments: Sequence[Segment], names: Mapping[str, str], dataset: Dataset) -> dict[int, tuple[str, ...]]:
    """Returns the tags of each labelled trajectory, with the skills of its labels."""
    found = {each.trajectory: set(dataset.skills[each.trajectory]) for each in segments}
    for each in segments:
        found[each.trajectory].add(names[each.skill])
    return {index: tuple(sorted(skills)) for index, skills in found.items()}
