"""Problems of the tags of a dataset, as `freerein dataset check` and fits see them."""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

_SUBJECT = "skills"
FEWEST = 10
"""Trajectories with a skill, and without it, below which a held-out tenth hardly has one of each."""


@dataclass(frozen=True)
class Problem:
    """A problem of a dataset: what was expected and found, and how to mend it.

    Attributes:
        where: The file, relative to the dataset, or another subject.
        severity: `error` where a fit refuses the dataset or data is damaged; `warning` where a fit learns less.
    """

    where: str
    sentence: str
    hint: str
    severity: Literal["error", "warning"] = "error"


def tag_problems(skills: Sequence[str], tags: Sequence[Sequence[str]]) -> list[Problem]:
    """Returns the problems of the tags of each trajectory, empty where unknown, of a dataset of these skills."""
    return [*_errors(skills, tags), *_warnings(skills, [frozenset(each) for each in tags if each])]


def _errors(skills: Sequence[str], tags: Sequence[Sequence[str]]) -> Iterator[Problem]:
    if not skills:
        sentence = "Trajectories must be tagged with the skills that occur in them; the dataset names no skills."
        yield Problem(_SUBJECT, sentence, "Tag them: freerein dataset tag NAME tags.csv.")
        return
    untagged = sum(not each for each in tags)
    if untagged:
        sentence = f"Every trajectory must be tagged with the skills that occur in it; {untagged} are not."
        yield Problem(_SUBJECT, sentence, "Tag them, freerein dataset tag NAME tags.csv, or leave them out.")
    unknown = {skill for each in tags for skill in each} - set(skills)
    if unknown:
        sentence = f"Tags must be among the dataset's {len(skills)} skills; {len(unknown)} tags are not."
        yield Problem(_SUBJECT, sentence, "Correct them: freerein dataset tag NAME tags.csv.")


def _warnings(skills: Sequence[str], tags: Sequence[frozenset[str]]) -> Iterator[Problem]:
    together = defaultdict[frozenset[int], list[str]](list)
    for skill in skills:
        occurs = frozenset(index for index, each in enumerate(tags) if skill in each)
        if tags and len(occurs) in (0, len(tags)):
            found = "all: tags cannot tell where in a trajectory it is" if occurs else "none"
            sentence = (
                f"The skill {skill!r} must occur in some trajectories and be missing in others; it occurs in {found}."
            )
            yield _warning(sentence, "Record trajectories with it and trajectories without it.")
            continue
        together[occurs].append(skill)
        for count, relation in ((len(occurs), "with"), (len(tags) - len(occurs), "without")):
            if count < FEWEST:
                sentence = f"A skill needs {FEWEST} or more trajectories {relation} it; {skill!r} has {count}."
                yield _warning(sentence, "Record more of them.")
    for names in together.values():
        if len(names) > 1:
            sentence = (
                f"Skills must occur apart in some trajectories; {', '.join(map(repr, names))} always occur together: "
                "tags cannot tell which is which."
            )
            yield _warning(sentence, "Record trajectories with one and not the other, or tag them as one skill.")


def _warning(sentence: str, hint: str) -> Problem:
    return Problem(_SUBJECT, sentence, hint, "warning")
