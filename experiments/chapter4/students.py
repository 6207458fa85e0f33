"""Students of the 18 teachers: how each is distilled, what it is evaluated in, and what it earns there.

<student>/unseen.json   what a scan of the whole dataset found in the colour of the test tasks

`DONE` and `EYE` are fitted again to the rollouts of `OURS`, told a text: one says when its goal is reached, the other
has an eye that has never seen the test colour. `RENAMED` is `DISSERTATION`, told a word for that colour that nobody
knows: of what `OURS` is told, a word is a place among those of its eye, and another word would be the same place.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import chain
from types import MappingProxyType
from typing import Any

from experiments.chapter4.tasks import PARTS, TASK_SETS, TEST, TEST_COLOUR
from experiments.robustness.evaluated import evaluate, flagged
from experiments.teachers import SEEN, STARTS, TASKS
from experiments.workbench.pipelines import Step, Trials, fit_step, step
from experiments.workbench.results import Sample
from freerein_sim.worlds.tasks import tasks as named_tasks

OURS, DISSERTATION, RANDOM, IN_SCENES = "ours", "dissertation", "random", "ours_in_scenes"
DONE, EYE, RENAMED = "ours_done", "eye_without_blue", "blue_renamed"
DATASET, _STUDENT, _REFIT = "rollouts", "student", "refit"
UNKNOWN_WORD = "tulver"
ROLLOUTS = 50
"""Of each teacher's task, in all iterations together."""

RETURN, POINTS = "return", "points"
ORDERS: Mapping[str, bool] = MappingProxyType({"in-order": True, "wrong-order": False})
_IN_ORDER = "start/in-order"
_HOLDS = "holds"
_SAID = ("confidence", _HOLDS)
LIGHTS = ("light-0.6", "light-0.8", "light-1.2", "light-1.4", "warm", "cool")
SCENES = (*LIGHTS, "camera-5cm", "blocks-3")
"""Conditions under which ours, told a text, is evaluated in all tasks: arms of their own, `IN_SCENES`."""

EPISODES_OF_SCENE = 10
"""They begin as the first of the others do."""

_EPISODES, _MOST_ENVS = 50, 25

_REACHED_WEIGHT = 0.3

_FITS: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        OURS: {"encoder": "goal_eye", "fusion": "concatenate", "steps": 8_000, "batch_size": 512},
        DISSERTATION: {
            "fusion": "concatenate",
            "text_code": "sentence",
            "unseen_objects": True,
            "max_shift": 0.0,
            "resized_crops": True,
            "amsgrad": True,
            "lr": 1e-4,
            "steps": 32_000,
        },
    }
)
"""Of the fits of students. The dissertation's has a ResNet18 of 128 pixels and 300 epochs; here it is the encoder that
all policies have, of 64 pixels, and 51 epochs: as many samples as the last fit of ours has."""

_ITERATIONS: Mapping[str, int] = MappingProxyType({OURS: 5, DISSERTATION: 1})
"""Of rollouts: the student acts in those after the first."""


def distil(method: str, conditioning: str, seed: int) -> Step:
    """Returns the step that distils a student."""
    iterations = _ITERATIONS[method]
    rollouts = ROLLOUTS // iterations
    return step(
        _STUDENT,
        "distill",
        teachers=list(TASKS),
        rollouts=rollouts,
        dagger_iterations=iterations - 1,
        num_envs=min(_MOST_ENVS, rollouts),
        dataset=DATASET,
        model_name=_STUDENT,
        seed=seed,
        config=_fit(method, conditioning, seed),
    )


def refit(seed: int, *, says_when_done: bool = False) -> Step:
    """Returns the step that fits ours, told a text, to the rollouts of the student that was distilled."""
    weight = {"reached_weight": _REACHED_WEIGHT} if says_when_done else {}
    return fit_step(_REFIT, "imitation", DATASET, method="language", **{**_fit(OURS, "text", seed), **weight})


def _fit(method: str, conditioning: str, seed: int) -> dict[str, Any]:
    return {**_FITS[method], "conditioning": conditioning, "reached_weight": 0.0, "seed": seed}


@dataclass(frozen=True)
class _Cell:
    """An evaluation: its part of the table, such as `train.seen`, its step, its task, starts and conditions."""

    part: str
    step: str
    task: str
    starts: str = SEEN
    conditions: Mapping[str, Any] = field(default_factory=dict)
    episodes: int = _EPISODES


_CELLS = tuple(
    _Cell(f"{tasks}.{starts}", f"{tasks}-{starts}-{number}", task, starts, conditions)
    for tasks, members in TASK_SETS.items()
    for starts, conditions in STARTS.items()
    for number, task in enumerate(members)
)
_CELLS_OF_SCENES = tuple(
    _Cell(
        f"{tasks}.{scene}",
        f"{tasks}-{scene.replace('.', '-')}-{number}",
        task,
        conditions={"conditions": [scene]},
        episodes=EPISODES_OF_SCENE,
    )
    for scene in SCENES
    for tasks, members in TASK_SETS.items()
    for number, task in enumerate(members)
)


_PAIRS = {
    f"{tasks}-done-{number}": (tasks, pair)
    for tasks, members in TASK_SETS.items()
    for number, pair in enumerate(zip(members[::2], members[1::2], strict=True))
}
"""Set and tasks of the evaluations of what a student says of reaching its goal, by step. In each task it is told both
texts; what it says of the other one is not counted."""


def evaluations(policy: Any) -> Iterator[Step]:
    """Yields the steps that evaluate a policy in every task, from both kinds of starts."""
    return map(partial(_evaluation, policy), _CELLS)


def renamed_evaluations() -> Iterator[Step]:
    """Yields those in test tasks of the student that was distilled last, told the unknown word."""
    for each in _CELLS:
        if each.part.startswith(TEST):
            text = named_tasks()[each.task].goal_text.replace(TEST_COLOUR, UNKNOWN_WORD)
            yield _evaluation({**taught(), "goal_text": text}, each)


def done_evaluations() -> Iterator[Step]:
    """Yields the steps that have the student that was fitted again say when its goal is reached, in every task."""
    for name, (_, (task, other)) in _PAIRS.items():
        more = {"task": task, "other_tasks": [other], "policy": refitted(), "episodes": _EPISODES}
        yield evaluate("sentences", name, **more)


def taught() -> dict[str, str]:
    """Returns the policy that was distilled last."""
    return {"model": _STUDENT}


def refitted() -> dict[str, str]:
    """Returns the policy that was fitted again."""
    return {"run": _REFIT}


def evaluations_in(scene: str) -> Iterator[Step]:
    """Yields the steps that evaluate the student that was stored last in every task, from seen starts in a scene."""
    cells = (each for each in _CELLS_OF_SCENES if each.conditions["conditions"] == [scene])
    return map(partial(_evaluation, taught()), cells)


def _evaluation(policy: Any, cell: _Cell) -> Step:
    return evaluate("returns", cell.step, task=cell.task, policy=policy, episodes=cell.episodes, **cell.conditions)


def samples(trials: Trials) -> Iterator[tuple[str, Sample]]:
    """Yields returns as a share of the expert's in the same episodes, and in points; all, and by the starting order.

    Tasks of stacking have no order. A trial is an episode; those of all tasks of a set are together.
    """
    for part in PARTS:
        episodes = [trial for each in _CELLS if each.part == part for trial in trials.get(each.step, ())]
        if not episodes:
            continue
        yield from _samples(part, episodes)
        for order, holds in ORDERS.items():
            yield from _samples(
                f"{part}.{order}", [each for each in episodes if each["starts"].get(_IN_ORDER) is holds]
            )


def samples_in_scenes(trials: Trials) -> Iterator[tuple[str, Sample]]:
    """Yields returns as a share of the expert's in the same episodes, by scene and set of tasks."""
    for part in dict.fromkeys(each.part for each in _CELLS_OF_SCENES):
        episodes = [trial for each in _CELLS_OF_SCENES if each.part == part for trial in trials[each.step]]
        yield f"{part}.{RETURN}", _share(episodes)


def done_samples(trials: Trials) -> Iterator[tuple[str, Sample]]:
    """Yields what a student's confidence that its goal is reached is worth, and its return in points, by set of tasks.

    A trial is a start: an episode of each task.
    """
    for tasks, members in TASK_SETS.items():
        starts = [*zip(*(trials[name] for name, (of, _) in _PAIRS.items() if of == tasks), strict=True)]
        said = [{key: [*chain.from_iterable(each[key] for each in start)] for key in _SAID} for start in starts]
        yield from ((f"{tasks}.{name}", sample) for name, sample in flagged(said, _HOLDS))
        own = [sum(each["returns"][task][task] for each in start for task in (0, 1)) for start in starts]
        yield f"{tasks}.{POINTS}", Sample(own, [len(members)] * len(own))


def figures(trials: Trials) -> Iterator[tuple[str, float]]:
    """Yields the share of the expert's return in each task, from each kind of starts."""
    for each in _CELLS:
        if each.step in trials:
            yield f"{each.task}.{each.starts}", round(_share(trials[each.step]).mean, 4)


def _samples(part: str, episodes: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, Sample]]:
    yield f"{part}.{RETURN}", _share(episodes)
    yield f"{part}.{POINTS}", Sample([each["episode_return"] for each in episodes], [1] * len(episodes))


def _share(episodes: Sequence[Mapping[str, Any]]) -> Sample:
    return Sample([each["episode_return"] for each in episodes], [each["expert_return"] for each in episodes])
