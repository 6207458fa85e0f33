"""Claims: what results say of each target, and the worst of the figures that it names."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from experiments.robustness import visited_states
from experiments.robustness.target import Target
from experiments.robustness.targets import BASELINE, LEAST_RUNS, OURS, TARGETS
from experiments.workbench import claims
from experiments.workbench.claims import Claim
from experiments.workbench.results import ArmResult, Sample

_DIGITS = 4


@dataclass(frozen=True, eq=False)
class Made:
    """A claim of a target, the name of the figure that is the worst, and the arms whose trials are joined."""

    target: Target
    claim: Claim
    worst: str
    arms: Sequence[ArmResult]


def make_claims(results: Sequence[ArmResult], wanted: Sequence[Target] = TARGETS) -> list[Made]:
    """Returns the claims whose arms have results."""
    found = [made for target in wanted if (made := _make(target, results))]
    reached = {made.claim.claim: bool(made.claim.met) for made in found}
    return [_with_others(made, reached) if made.target.also else made for made in found]


def samples_of(results: Sequence[ArmResult], name: str) -> list[Sample]:
    """Returns a figure of each seed; trials in several worlds are joined."""
    by_seed: dict[int, list[ArmResult]] = {}
    for result in results:
        by_seed.setdefault(result.seed, []).append(result)
    parts = ([_with_derived(result.samples, name)[name] for result in each] for each in by_seed.values())
    return [visited_states.join(each) for each in parts]


def _make(target: Target, results: Sequence[ArmResult]) -> Made | None:
    arms = [each for each in _arms(target, results, target.method, OURS) if _has(each, target.samples)]
    others = _arms(target, results, target.baseline, "" if target.method else BASELINE)
    ceilings = _arms(target, results, target.ceiling)
    if not arms:
        return None
    if target.of_runs:
        return _make_of_runs(target, arms)
    values = {name: target.unit * claims.mean(samples_of(arms, name)) for name in target.samples}
    worst = (max if target.least is None else min)(values, key=values.__getitem__)
    samples = samples_of(arms, worst)
    low, _ = claims.interval(samples)
    baseline, ceiling = (_mean(target, each, worst) for each in (others, ceilings))
    claim = claims.claim_of(
        target.claim,
        arms,
        samples,
        unit=target.unit,
        digits=_DIGITS,
        seeds=len(samples),
        baseline=baseline,
        ceiling=ceiling,
        target=target.least if target.most is None else target.most,
        met=_is_met(target, arms, _rounded(values[worst]), target.unit * low) if target.has_bar else None,
        command=_command(arms),
    )
    return Made(target, claim, worst, arms)


def _has(result: ArmResult, names: Sequence[str]) -> bool:
    """Returns whether a result has these samples; those of an earlier evaluation may lack some."""
    return all(name in result.samples for name in names)


def _is_met(target: Target, arms: Sequence[ArmResult], value: float, low: float) -> bool:
    """Returns whether a claim is met: by all the seeds that it needs, in each of its worlds."""
    present = Counter(each.world for each in arms)
    is_complete = all(present[world] >= target.seeds for world in target.worlds)
    return is_complete and target.is_reached(value, low) and all(_is_apart(arms, *pair) for pair in target.apart)


def _is_apart(arms: Sequence[ArmResult], upper: str, lower: str) -> bool:
    """Returns whether the interval of one figure lies above that of another."""
    if not all(_has(each, (upper, lower)) for each in arms):
        return False
    return claims.interval(samples_of(arms, upper))[0] > claims.interval(samples_of(arms, lower))[1]


def _make_of_runs(target: Target, results: Sequence[ArmResult]) -> Made:
    """Returns a claim of runs on one processor; others are in the table only."""
    (processor, _), *_ = Counter(processor_of(each) for each in results).most_common()
    runs = [each for each in results if processor_of(each) == processor]
    (name,) = target.samples
    values = [target.unit * each.samples[name].mean for each in runs if name in each.samples]
    median, low, high = (_rounded(float(each)) for each in (np.median(values), min(values), max(values)))
    claim = Claim(
        claim=target.claim,
        value=median,
        low=low,
        high=high,
        seeds=None,
        trials=len(values),
        target=target.least,
        met=target.is_reached(median, low) and len(values) >= LEAST_RUNS if target.has_bar else None,
        world_version=runs[0].world_version,
        command=_command(runs),
        minutes=round(sum(each.minutes for each in runs), 2),
    )
    return Made(target, claim, processor, runs)


def _with_derived(samples: Mapping[str, Sample], name: str) -> Mapping[str, Sample]:
    """Returns samples, and where they lack a figure what follows from those of visited states."""
    return samples if name in samples else visited_states.derived(samples)


def processor_of(result: ArmResult) -> str:
    """Returns the processor that an arm ran on."""
    return str(result.machine["processor"])


def _with_others(made: Made, reached: Mapping[str, bool]) -> Made:
    others = all(reached.get(name, False) for name in made.target.also)
    return replace(made, claim=replace(made.claim, met=bool(made.claim.met) and others))


def _arms(target: Target, results: Sequence[ArmResult], method: str, variant: str = "") -> list[ArmResult]:
    """Returns the arms of a method in a target's worlds; without a method, the fits of a variant there."""
    return [
        each
        for each in results
        if (each.method == method if method else each.options.get("fit") == variant) and each.world in target.worlds
    ]


def _mean(target: Target, arms: Sequence[ArmResult], name: str) -> float | None:
    return _rounded(target.unit * claims.mean(samples_of(arms, name))) if arms else None


def _command(arms: Sequence[ArmResult]) -> str:
    """Returns the command that makes the arms, in a pattern for each world."""
    patterns = dict.fromkeys(f"'{arm.name.removesuffix(str(arm.seed))}*'" for arm in arms)
    return f"python -m experiments run robustness --only {' '.join(patterns)}"


def _rounded(value: float) -> float:
    return round(value, _DIGITS)
