"""The table of one policy from many: its claims, and rows by conditioning, starting order, student and task."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain
from statistics import mean
from typing import Any

import numpy as np

from experiments.chapter4.students import DISSERTATION, IN_SCENES, LIGHTS, ORDERS, OURS, POINTS, RANDOM, RETURN, SCENES
from experiments.chapter4.tasks import PARTS, TASK_SETS, TEST
from experiments.teachers import SEEN, STARTS
from experiments.workbench import claims
from experiments.workbench.claims import Claim
from experiments.workbench.plots import interval_plot
from experiments.workbench.results import ArmResult, Sample
from experiments.workbench.table import Picture, Section, Table, words

_PER_CENT, _SEEDS = 100, 3
_COMMAND = "python -m experiments run table_4_2"
_LEAST = {"train.seen": 65.0, "train.unseen": 50.0, "test.seen": 55.0, "test.unseen": 42.0}
_DISSERTATION = {
    ("text", "train.seen"): 29.89,
    ("text", "test.seen"): 22.41,
    ("text", "train.unseen"): 21.14,
    ("text", "test.unseen"): 15.69,
    ("code", "train.seen"): 26.71,
    ("code", "test.seen"): 17.20,
    ("code", "train.unseen"): 17.03,
    ("code", "test.unseen"): 11.74,
    ("none", "train.seen"): 17.91,
    ("none", "test.seen"): 14.82,
    ("none", "train.unseen"): 14.81,
    ("none", "test.unseen"): 10.79,
}
"""Table 4.2, in points."""

_LEAST_IN_LIGHT = 70.0
"""Of the return in the nominal light, in the worst of `LIGHTS`, per cent."""

_ORDERED = f"{TEST}.{SEEN}"
"""Where conditionings are compared."""

_BY_SCENE = "Ours told a text, in other scenes, of the nominal return, %"
_BY_TASK = "Ours told a text, by task: mean of all seeds, % of the expert"

Students = dict[tuple[str, str], list[ArmResult]]
"""Results by method and conditioning, by seed."""


def table(results: Sequence[ArmResult]) -> Table:
    """Returns the table of the students that have results."""
    students = _students(results)
    made = tuple(_claims(students))
    draw = partial(interval_plot, _in_per_cent(made), title="One policy from many", unit="per cent of the expert")
    return Table(
        title="Table 4.2: one policy from many",
        text=words("table_4_2"),
        sections=(
            Section(_header("% of the expert"), tuple(_rows(students, RETURN, _PER_CENT)), "Share of the expert"),
            Section(_header("points"), (*_dissertation(), *_rows(students, POINTS, 1)), "Points, of 100 timesteps"),
            Section(
                _header("% of the expert"), tuple(_rows_by_order(students)), "By the order at the start, left and right"
            ),
            Section(
                _header("% of the expert"),
                tuple(_rows_of_students(students)),
                "Every student",
            ),
            *_scenes(students),
            Section(("task", *(f"{starts} starts, %" for starts in STARTS)), tuple(_rows_by_task(students)), _BY_TASK),
        ),
        claims=made,
        picture=Picture("Returns of students", draw),
    )


def _students(results: Sequence[ArmResult]) -> Students:
    found: Students = {}
    for each in sorted(results, key=lambda result: result.seed):
        found.setdefault((each.method, each.options.get("conditioning", "")), []).append(each)
    return found


def _in_nominal_scenes(students: Students) -> Iterator[tuple[tuple[str, str], list[ArmResult]]]:
    return ((row, arms) for row, arms in students.items() if row[0] != IN_SCENES)


def _claims(students: Students) -> Iterator[Claim]:
    """Yields returns of every student, and by how much a text is more than a code, and than nothing, on test tasks."""
    for (method, how), arms in students.items():
        if method in (RANDOM, IN_SCENES):
            continue
        for part in PARTS:
            yield _return_claim(students, method, how, part, arms)
            yield _points_claim(method, how, part, arms)
    text = students.get((OURS, "text"), [])
    compared = [_difference(text, students.get((OURS, how), []), how) for how in ("code", "none")]
    if text and (shown := students.get((IN_SCENES, "text"), [])):
        yield _light_claim(text, shown)
    found = [each for each in compared if each is not None]
    yield from found
    if len(found) == len(compared):
        least = min(found, key=lambda claim: claim.value)
        yield replace(least, claim="conditioning_order", met=all(each.met for each in found))


def _name(method: str, how: str, part: str) -> str:
    """Returns the name of a claim; ours by text has that of the table's row."""
    student = "language" if (method, how) == (OURS, "text") else f"{method}_{how}"
    return f"{student}_{part.replace('.', '_')}"


def _return_claim(students: Students, method: str, how: str, part: str, arms: Sequence[ArmResult]) -> Claim:
    samples = _samples(arms, part, RETURN)
    is_claimed = (method, how) == (OURS, "text")
    least = _LEAST[part] if is_claimed else None
    before = students.get((DISSERTATION, "text"), [])
    has_baseline = is_claimed and before
    return claims.claim_of(
        _name(method, how, part),
        arms,
        samples,
        unit=_PER_CENT,
        seeds=len(arms),
        scale="full" if method == OURS else "reduced",
        baseline=round(_PER_CENT * claims.mean(_samples(before, part, RETURN)), 3) if has_baseline else None,
        ceiling=float(_PER_CENT),
        target=least,
        met=None if least is None else len(arms) == _SEEDS and _PER_CENT * claims.mean(samples) >= least,
        command=_COMMAND,
    )


def _points_claim(method: str, how: str, part: str, arms: Sequence[ArmResult]) -> Claim:
    returns, points = _samples(arms, part, RETURN), _samples(arms, part, POINTS)
    expert = [Sample(share.counts, each.counts) for share, each in zip(returns, points, strict=True)]
    return claims.claim_of(
        f"{_name(method, how, part)}_points",
        arms,
        points,
        seeds=len(arms),
        scale="full" if method == OURS else "reduced",
        ceiling=round(claims.mean(expert), 3),
        dissertation=_DISSERTATION[how, part],
        command=_COMMAND,
    )


def _light_claim(text: Sequence[ArmResult], in_scenes: Sequence[ArmResult]) -> Claim:
    """Returns the claim of the worst light, over the sets of tasks, in seen starts."""
    values = {(tasks, light): _of_nominal(text, in_scenes, tasks, light) for tasks in TASK_SETS for light in LIGHTS}
    tasks, light = min(values, key=lambda scene: values[scene])
    shown, nominal = _samples(in_scenes, f"{tasks}.{light}", RETURN), _samples(text, f"{tasks}.{SEEN}", RETURN)
    low, high = claims.ratio_interval(shown, nominal)
    value = _PER_CENT * values[tasks, light]
    made = claims.claim_of(
        "policy_light",
        in_scenes,
        shown,
        unit=_PER_CENT,
        seeds=len(in_scenes),
        target=_LEAST_IN_LIGHT,
        met=len(in_scenes) == _SEEDS and value >= _LEAST_IN_LIGHT,
        command=_COMMAND,
    )
    return replace(made, value=round(value, 3), low=round(_PER_CENT * low, 3), high=round(_PER_CENT * high, 3))


def _of_nominal(text: Sequence[ArmResult], in_scenes: Sequence[ArmResult], tasks: str, scene: str) -> float:
    shown, nominal = _samples(in_scenes, f"{tasks}.{scene}", RETURN), _samples(text, f"{tasks}.{SEEN}", RETURN)
    return claims.mean(shown) / claims.mean(nominal)


def _difference(text: Sequence[ArmResult], others: Sequence[ArmResult], how: str) -> Claim | None:
    """Returns by how much more a text is worth, in the same episodes, as a share of the expert's return."""
    seeds, told = (
        {arm.seed: sample for arm, sample in zip(arms, _samples(arms, _ORDERED, RETURN), strict=True)}
        for arms in (others, text)
    )
    paired = [(sample, seeds[seed]) for seed, sample in told.items() if seed in seeds]
    if not paired:
        return None
    gains = [
        Sample([one - another for one, another in zip(own.totals, other.totals, strict=True)], own.counts)
        for own, other in paired
    ]
    low, _ = claims.interval(gains)
    more: dict[str, Any] = {"unit": _PER_CENT, "seeds": len(gains), "target": 0.0, "command": _COMMAND}
    met = len(gains) == _SEEDS and low > 0
    return claims.claim_of(f"conditioning_text_over_{how}", [*text, *others], gains, met=met, **more)


def _samples(arms: Sequence[ArmResult], part: str, figure: str) -> list[Sample]:
    """Returns a figure of a set of tasks by seed. A trial is a start: an episode of each task, which all draw alike."""
    tasks = len(TASK_SETS[part.partition(".")[0]])
    return [_by_start(each.samples[f"{part}.{figure}"], tasks) for each in arms]


def _by_start(episodes: Sample, tasks: int) -> Sample:
    totals, counts = (np.reshape(each, (tasks, -1)).sum(axis=0).tolist() for each in (episodes.totals, episodes.counts))
    return Sample(totals, counts)


def _header(unit: str) -> tuple[str, ...]:
    return ("student", "told", "seeds", *(f"{part.replace('.', ', ')} starts, {unit}" for part in PARTS))


def _rows(students: Students, figure: str, unit: float) -> Iterator[tuple[str, ...]]:
    for (method, how), arms in _in_nominal_scenes(students):
        yield method, how, str(len(arms)), *(_cell(_samples(arms, part, figure), unit) for part in PARTS)


def _rows_by_order(students: Students) -> Iterator[tuple[str, ...]]:
    for (method, how), arms in _in_nominal_scenes(students):
        for order in ORDERS:
            shares = ([each.samples[f"{part}.{order}.{RETURN}"] for each in arms] for part in PARTS)
            cells = (f"{_PER_CENT * claims.mean(each):.1f}" for each in shares)
            yield f"{method}, {order.replace('-', ' ')}", how, str(len(arms)), *cells


def _rows_of_students(students: Students) -> Iterator[tuple[str, ...]]:
    for (method, how), arms in _in_nominal_scenes(students):
        for arm in arms:
            yield method, how, f"seed {arm.seed}", *(_cell(_samples([arm], part, RETURN), _PER_CENT) for part in PARTS)


def _scenes(students: Students) -> Iterator[Section]:
    text, in_scenes = (students.get((method, "text"), []) for method in (OURS, IN_SCENES))
    if text and in_scenes:
        shown = ([_of_nominal(text, in_scenes, tasks, scene) for scene in SCENES] for tasks in TASK_SETS)
        rows = zip(TASK_SETS, shown, strict=True)
        cells = tuple((tasks, *(f"{_PER_CENT * value:.1f}" for value in values)) for tasks, values in rows)
        yield Section(("tasks", *SCENES), cells, _BY_SCENE)


def _rows_by_task(students: Students) -> Iterator[tuple[str, ...]]:
    arms = students.get((OURS, "text"), [])
    for task in chain.from_iterable(TASK_SETS.values()):
        shares = [[each.figures[f"{task}.{starts}"] for each in arms] for starts in STARTS]
        yield task, *(f"{_PER_CENT * mean(each):.1f}" if each else "" for each in shares)


def _dissertation() -> Iterator[tuple[str, ...]]:
    for how in ("text", "code", "none"):
        yield "as printed", how, "", *(f"{_DISSERTATION[how, part]:.1f}" for part in PARTS)


def _cell(samples: Sequence[Sample], unit: float) -> str:
    low, high = claims.interval(samples)
    return f"{unit * claims.mean(samples):.1f} [{unit * low:.1f}, {unit * high:.1f}]"


def _in_per_cent(made: Sequence[Claim]) -> list[Claim]:
    return [each for each in made if each.ceiling == _PER_CENT]
