"""Policies of `blocks` that follow sentences: distilled from policies that come with freerein, and told what to do."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from experiments.robustness.evaluated import evaluate, flagged
from experiments.workbench.arms import Arm
from experiments.workbench.pipelines import Step, Trials, step
from experiments.workbench.results import Sample

TOLD_OWN, WORDINGS = "told.own", "told.wordings"

SIDES = ("blocks.yellow-left-of-green", "blocks.yellow-right-of-green")
TEACHERS = ("yellow-left-of-green", "yellow-right-of-green")
"""Shipped policies, from which a language policy is distilled."""

WORDINGS_OF_SIDES = tuple(
    wording.format(side=side, other=other)
    for side, other in (("left", "right"), ("right", "left"))
    for wording in (
        "I want the yellow block {side} of the green one",
        "could you place the yellow cube to the {side} of the green cube?",
        "Arrange the blocks so that yellow is {side} of green!",
        "A green block to the {other} of a yellow block",
        "slide the green one to the {other} of the yellow one",
    )
)
"""Wordings and converses, of the left, then of the right; none is a goal text that a policy is trained on.

The random texts that train the text reader have `yellow`, `green`, `block`, and the wordings of relations. Held out are
verbs (`want`, `arrange`, `slide`), the sentences around a statement (`could you`, `so that`), and `cube`. The converse
without a verb has nothing that is held out.
"""

_SENTENCE_EPISODES = 32
_STUDENT, _WORD_BLIND = "student", "word-blind"


def obey(arm: Arm) -> list[Step]:
    """Returns the steps that distil two students, one of them word-blind, and tell them what to do."""
    left, right = SIDES
    told = {"task": left, "other_tasks": [right], "other_texts": list(WORDINGS_OF_SIDES)}
    conditioning = {_STUDENT: "text", _WORD_BLIND: "none"}
    return [
        *(_distil(arm, name, conditioning=each, reached_weight=0.0) for name, each in conditioning.items()),
        *(
            evaluate("sentences", _told(name), policy={"run": name}, episodes=_SENTENCE_EPISODES, **told)
            for name in conditioning
        ),
        *_teachers(),
    ]


def say_when_done(arm: Arm, **config: Any) -> list[Step]:
    """Returns the steps that distil a student that says when its goal is reached, and tell it what to do."""
    left, right = SIDES
    told = {"task": left, "other_tasks": [right], "policy": {"run": _STUDENT}}
    return [
        _distil(arm, _STUDENT, **config),
        evaluate("sentences", _told(_STUDENT), episodes=_SENTENCE_EPISODES, **told),
        *_teachers(),
    ]


def _distil(arm: Arm, name: str, **config: Any) -> Step:
    return step(
        name,
        "distill",
        teachers=list(TEACHERS),
        rollouts=100,
        dagger_iterations=3,
        num_envs=50,
        model_name=name,
        seed=arm.seed,
        config={"seed": arm.seed, **config},
    )


def _teachers() -> Iterator[Step]:
    for task, teacher in zip(SIDES, TEACHERS, strict=True):
        yield evaluate("returns", teacher, task=task, policy={"stored": teacher}, episodes=_SENTENCE_EPISODES)


def done_samples(trials: Trials) -> Iterator[tuple[str, Sample]]:
    """Yields the student's return as a share of its teachers', and what its confidence is worth, by trial."""
    student = trials[_told(_STUDENT)]
    yield TOLD_OWN, _of_teachers(student, trials)
    yield from flagged(student, "holds")


def _of_teachers(student: Sequence[Mapping[str, Any]], trials: Trials) -> Sample:
    taught = [[each["episode_return"] for each in trials[name]] for name in TEACHERS]
    own = [sum(each["returns"][task][task] for task in range(len(SIDES))) for each in student]
    return Sample(own, [sum(each) for each in zip(*taught, strict=True)])


def sentence_samples(trials: Trials) -> Iterator[tuple[str, Sample]]:
    """Yields the student's return as a share of its teachers', and what was done told wordings, by trial.

    Of each task also the return of the word-blind student, that of ours told the other task, and the difference.
    """
    student, word_blind = (trials[_told(name)] for name in (_STUDENT, _WORD_BLIND))
    yield TOLD_OWN, _of_teachers(student, trials)
    for task, name in enumerate(SIDES):
        other = 1 - task
        blind = [each["returns"][task][task] for each in word_blind]
        misled = [each["returns"][task][other] for each in student]
        losses = [one - another for one, another in zip(blind, misled, strict=True)]
        named = {told_other(name): losses, word_blind_return(name): blind, told_other_return(name): misled}
        yield from ((figure, Sample(each, [1] * len(each))) for figure, each in named.items())
    count = len(WORDINGS_OF_SIDES)
    meant = np.arange(count) >= count // 2  # the left task's, then the right one's
    done = [np.array(each["successes"])[meant.astype(int), len(SIDES) + np.arange(count)] for each in student]
    yield WORDINGS, Sample.of_flags(done)


def told_other(task: str) -> str:
    """Returns the name of a figure: the word-blind student's return in a task less that of ours, told the other."""
    return f"told.other.{task}"


def word_blind_return(task: str) -> str:
    """Returns the name of a figure: the word-blind student's return in a task."""
    return f"told.blind.{task}"


def told_other_return(task: str) -> str:
    """Returns the name of a figure: our student's return in a task, told the other."""
    return f"told.misled.{task}"


def _told(student: str) -> str:
    return f"{student}-told"
