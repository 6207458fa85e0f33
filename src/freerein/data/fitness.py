"""Whether skills can be learnt from a dataset that is whole."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from freerein.data.integrity import Problem
from freerein.data.reader import Dataset
from freerein.errors import InvalidInput


def check(root: Path) -> list[Problem]:
    """Returns everything that keeps skills from being learnt from a dataset; empty when it is fit for training.

    Raises:
        NotFound: There is no dataset in `root`.
        InvalidInput: It cannot be opened; `verify` says why.
    """
    dataset = Dataset(root)
    if len(dataset) == 0:
        return [Problem("data", "A dataset must hold trajectories; this one is empty.", "Record demonstrations first.")]
    trajectories = (problem for index in range(len(dataset)) for problem in _trajectory_problems(dataset, index))
    return [*_skill_problems(dataset), *trajectories]


def _skill_problems(dataset: Dataset) -> Iterator[Problem]:
    if not dataset.spec.skills:
        sentence = "Trajectories must be tagged with the skills that occur in them; the dataset names no skills."
        yield Problem("skills", sentence, "Record demonstrations of a task with skills, or tag the trajectories.")
        return
    untagged = dataset.skills.count(())
    if untagged:
        sentence = f"Every trajectory must be tagged with the skills that occur in it; {untagged} are not."
        yield Problem("skills", sentence, "Tag them, or leave them out.")
    for skill in dataset.spec.skills:
        count = sum(skill in skills for skills in dataset.skills)
        if count in (0, len(dataset)):
            found = "none" if count == 0 else "all: tags cannot tell where in a trajectory it is"
            sentence = (
                f"The skill {skill!r} must occur in some trajectories and be missing in others; it occurs in {found}."
            )
            yield Problem("skills", sentence, "Record trajectories with it and trajectories without it.")


def _trajectory_problems(dataset: Dataset, index: int) -> Iterator[Problem]:
    where = f"trajectory {index}"
    if dataset.lengths[index] == 0:
        yield Problem(where, "A trajectory must have at least one timestep; this one has none.", "Leave it out.")
        return
    try:
        actions = dataset[index].actions
    except InvalidInput as error:
        yield Problem(where, error.detail, error.hint)
        return
    choices = dataset.spec.action.choices
    low, high = (0, choices - 1) if choices else (-1, 1)
    outside = int(np.sum(~((actions >= low) & (actions <= high))))
    if outside:
        sentence = f"Actions must be finite and in [{low}, {high}]; {outside} of {actions.size} numbers are not."
        yield Problem(where, sentence, "Scale the actions by the robot's limits before recording.")
