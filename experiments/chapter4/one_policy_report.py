"""The table of one policy from many: its claims, and rows by conditioning, starting order, student and task."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain
from statistics import mean
from typing import Any

import numpy as np

from experiments.chapter4.students import (
    DISSERTATION,
    DONE,
    IN_SCENES,
    LIGHTS,
    ORDERS,
    OURS,
    POINTS,
    RANDOM,
    RETURN,
    SCENES,
)
from experiments.chapter4.tasks import PARTS, TASK_SETS, TEST
from experiments.robustness.evaluated import FLAG_AUROC, FLAG_ECE
from experiments.teachers import SEEN, STARTS, UNSEEN
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

_LEAST_AUROC, _MOST_ECE = 0.95, 0.05
"""Of what a student says of reaching its goal, in the worse set of tasks."""

_ORDERED = {"": f"{TEST}.{SEEN}", "_unseen": f"{TEST}.{UNSEEN}"}
"""Where conditionings are compared, by what the names of the comparisons end with."""

_BY_SCENE = "Ours told a text, in other scenes, of the nominal return, %"
_DONE = "Ours that says when its goal is reached, on states that it visits, by the oracle"
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
            *_done(students),
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
    return ((row, arms) for row, arms in students.items() if row[0] not in (IN_SCENES, DONE))


def _claims(students: Students) -> Iterator[Claim]:
    """Yields returns of every student, and by how much a text is more than a code, and than nothing, on test tasks."""
    for (method, how), arms in _in_nominal_scenes(students):
        for part in _parts(arms) if method != RANDOM else ():
            yield _return_claim(students, method, how, part, arms)
            yield _points_claim(method, how, part, arms)
    if lights := _in_lights(students):
        yield _light_claim(students, lights)
    yield from _done_claims(students.get((DONE, "text"), []))
    for suffix, part in _ORDERED.items():
        compared = [_difference(students, how, part, suffix) for how in ("code", "none")]
        found = [each for each in compared if each is not None]
        yield from found
        if len(found) == len(compared):
            least = min(found, key=lambda claim: claim.value)
            yield replace(least, claim=f"conditioning_order{suffix}", met=all(each.met for each in found))


def _parts(arms: Sequence[ArmResult]) -> list[str]:
    """Returns the parts in which students were evaluated."""
    return [part for part in PARTS if f"{part}.{RETURN}" in arms[0].samples]


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
        dissertation=_DISSERTATION[how, part] if method in (OURS, DISSERTATION) else None,
        command=_COMMAND,
    )


def _in_lights(students: Students) -> dict[tuple[str, str], list[Sample]]:
    """Returns returns in each scene by those in the nominal one, of the same students in the same episodes.

    By set of tasks and scene; a trial is a start.
    """
    nominal = {arm.seed: arm for arm in students.get((OURS, "text"), [])}
    paired = [(arm, nominal[arm.seed]) for arm in students.get((IN_SCENES, "text"), []) if arm.seed in nominal]
    if not paired:
        return {}
    return {
        (tasks, scene): [_of_nominal(*each, tasks, scene) for each in paired] for tasks in TASK_SETS for scene in SCENES
    }


def _of_nominal(in_scenes: ArmResult, nominal: ArmResult, tasks: str, scene: str) -> Sample:
    shown, usual = (
        np.reshape(arm.samples[f"{tasks}.{each}.{RETURN}"].totals, (len(TASK_SETS[tasks]), -1))
        for arm, each in ((in_scenes, scene), (nominal, SEEN))
    )
    return Sample(shown.sum(axis=0).tolist(), usual[:, : shown.shape[1]].sum(axis=0).tolist())


def _light_claim(students: Students, found: dict[tuple[str, str], list[Sample]]) -> Claim:
    """Returns the claim of the worst light, over the sets of tasks, in seen starts."""
    samples = min((each for (_, scene), each in found.items() if scene in LIGHTS), key=claims.mean)
    met = len(samples) == _SEEDS and _PER_CENT * claims.mean(samples) >= _LEAST_IN_LIGHT
    more: dict[str, Any] = {"unit": _PER_CENT, "seeds": len(samples), "target": _LEAST_IN_LIGHT, "command": _COMMAND}
    return claims.claim_of("policy_light", students[IN_SCENES, "text"], samples, met=met, **more)


def _done_claims(arms: Sequence[ArmResult]) -> Iterator[Claim]:
    """Yields AUROC and calibration error of what students say of reaching their goals, in the worse set of tasks."""
    if not arms:
        return
    auroc, ece = (
        worst([each.samples[f"{tasks}.{name}"] for each in arms] for tasks in TASK_SETS)
        for name, worst in ((FLAG_AUROC, partial(min, key=claims.mean)), (FLAG_ECE, partial(max, key=claims.mean)))
    )
    is_calibrated = len(arms) == _SEEDS and claims.mean(ece) <= _MOST_ECE
    more: dict[str, Any] = {"seeds": len(arms), "command": _COMMAND}
    met = is_calibrated and claims.mean(auroc) >= _LEAST_AUROC
    yield claims.claim_of("language_done", arms, auroc, target=_LEAST_AUROC, met=met, **more)
    yield claims.claim_of("language_done_ece", arms, ece, target=_MOST_ECE, met=is_calibrated, **more)


def _difference(students: Students, how: str, part: str, suffix: str) -> Claim | None:
    """Returns by how much more a text is worth, in the same episodes, as a share of the expert's return."""
    text, others = (students.get((OURS, each), []) for each in ("text", how))
    seeds, told = (
        {arm.seed: sample for arm, sample in zip(arms, _samples(arms, part, RETURN), strict=True)}
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
    return claims.claim_of(f"conditioning_text_over_{how}{suffix}", [*text, *others], gains, met=met, **more)


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
        yield method, how, str(len(arms)), *_part_cells(arms, figure, unit)


def _rows_by_order(students: Students) -> Iterator[tuple[str, ...]]:
    for (method, how), arms in _in_nominal_scenes(students):
        for order in ORDERS:
            shares = {part: [each.samples[f"{part}.{order}.{RETURN}"] for each in arms] for part in _parts(arms)}
            cells = (f"{_PER_CENT * claims.mean(shares[part]):.1f}" if part in shares else "" for part in PARTS)
            yield f"{method}, {order.replace('-', ' ')}", how, str(len(arms)), *cells


def _rows_of_students(students: Students) -> Iterator[tuple[str, ...]]:
    for (method, how), arms in _in_nominal_scenes(students):
        for arm in arms:
            yield method, how, f"seed {arm.seed}", *_part_cells([arm], RETURN, _PER_CENT)


def _scenes(students: Students) -> Iterator[Section]:
    if found := _in_lights(students):
        rows = ((tasks, *(_cell(found[tasks, scene], _PER_CENT) for scene in SCENES)) for tasks in TASK_SETS)
        yield Section(("tasks", *SCENES), tuple(rows), _BY_SCENE)


def _done(students: Students) -> Iterator[Section]:
    if arms := students.get((DONE, "text"), []):
        rows = tuple(
            (tasks, str(len(arms)), *(_done_cell(arms, f"{tasks}.{name}") for name in (FLAG_AUROC, FLAG_ECE, POINTS)))
            for tasks in TASK_SETS
        )
        yield Section(("tasks", "seeds", "AUROC", "ECE", "points"), rows, _DONE)


def _done_cell(arms: Sequence[ArmResult], name: str) -> str:
    samples = [each.samples[name] for each in arms]
    low, high = claims.interval(samples)
    return f"{claims.mean(samples):.3f} [{low:.3f}, {high:.3f}]"


def _rows_by_task(students: Students) -> Iterator[tuple[str, ...]]:
    arms = students.get((OURS, "text"), [])
    for task in chain.from_iterable(TASK_SETS.values()):
        shares = [[each.figures[f"{task}.{starts}"] for each in arms] for starts in STARTS]
        yield task, *(f"{_PER_CENT * mean(each):.1f}" if each else "" for each in shares)


def _dissertation() -> Iterator[tuple[str, ...]]:
    for how in ("text", "code", "none"):
        yield "as printed", how, "", *(f"{_DISSERTATION[how, part]:.1f}" for part in PARTS)


def _part_cells(arms: Sequence[ArmResult], figure: str, unit: float) -> Iterator[str]:
    parts = _parts(arms)
    return (_cell(_samples(arms, part, figure), unit) if part in parts else "" for part in PARTS)


def _cell(samples: Sequence[Sample], unit: float) -> str:
    low, high = claims.interval(samples)
    return f"{unit * claims.mean(samples):.1f} [{unit * low:.1f}, {unit * high:.1f}]"


def _in_per_cent(made: Sequence[Claim]) -> list[Claim]:
    return [each for each in made if each.ceiling == _PER_CENT]
