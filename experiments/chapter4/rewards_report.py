"""Tables of policies that were trained on several rewards: figures 4.4 and 4.6."""

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import starmap
from types import MappingProxyType

from experiments.chapter4.trained_on import (
    LEARNED,
    ORACLE,
    OURS,
    PLACE,
    POINTS,
    PUSH,
    RANDOM,
    RETURN,
    STACK,
    TOLD_FAILURE,
    TOLD_SUCCESS,
    TUNING,
    VICE,
)
from experiments.workbench import claims
from experiments.workbench.claims import Claim
from experiments.workbench.plots import interval_plot
from experiments.workbench.results import ArmResult, Sample
from experiments.workbench.table import Picture, Section, Table, words

_PER_CENT, _RATIO_SEEDS = 100, 5
_LEAST, _LEAST_LOW, _LEAST_ORACLE = 0.95, 0.85, 0.6
_RATIOS = MappingProxyType({PUSH: "push_ratio", STACK: "stack_ratio", PLACE: "place_ratio"})

_RATIO_HEADER = ("claim", "seeds", "ratio [95 % interval]", "of seeds resampled apart", "must reach", "met")
_CLASSIFIER = "What the classifier of `vice` tells right, in frames of 50 successes that it has not seen"

Group = tuple[str, str, str]
"""Task, tuning and reward."""


def manipulation(results: Sequence[ArmResult]) -> Table:
    """Returns the table of figure 4.6: a row for each task, tuning and reward, and for each training."""
    groups = _groups(results)
    ratios = tuple(_ratios(groups))
    returns = tuple(_return_claim("fig_4_6", group, arms, RETURN, _PER_CENT) for group, arms in groups.items())
    draw = partial(interval_plot, list(returns), title="Figure 4.6", unit="per cent of the expert's return")
    share = "% of the expert [95 % interval]"
    header = ("task", "tuning", "reward", "seeds", share, "points", "random actions, points", "every seed, %")
    return Table(
        title="Figure 4.6: rewards that policies were trained on",
        text=words("fig_4_6"),
        sections=(
            Section(_RATIO_HEADER, tuple(starmap(_ratio_row, ratios)), "Ratios"),
            Section(header, tuple(_row(group, arms) for group, arms in groups.items()), "Returns"),
            Section(("task", "seeds", "success, %", "failure, %"), tuple(_classifiers(groups)), _CLASSIFIER),
        ),
        claims=(*(claim for claim, _ in ratios), *returns),
        picture=Picture("Returns by reward", draw),
    )


def balance(results: Sequence[ArmResult]) -> Table:
    """Returns the table of figure 4.4: a row for each reward."""
    groups = _groups(results)
    made = tuple(_return_claim("fig_4_4", group, arms, POINTS, 1) for group, arms in groups.items())
    draw = partial(interval_plot, list(made), title="Figure 4.4", unit="return")
    rows = tuple(
        (reward, str(len(arms)), *(_cell(arms, name, 1) for name in (POINTS, RANDOM)), _each(arms, POINTS, 1))
        for (*_, reward), arms in groups.items()
    )
    return Table(
        title="Figure 4.4: the double inverted pendulum",
        text=words("fig_4_4"),
        sections=(Section(("reward", "seeds", "return [95 % interval]", "random actions", "every seed"), rows),),
        claims=made,
        picture=Picture("Returns by reward", draw),
    )


def _groups(results: Sequence[ArmResult]) -> dict[Group, list[ArmResult]]:
    found: dict[Group, list[ArmResult]] = {}
    for each in sorted(results, key=lambda result: result.seed):
        found.setdefault((each.world, each.options.get(TUNING, OURS), each.method), []).append(each)
    return dict(sorted(found.items()))


def _ratios(groups: dict[Group, list[ArmResult]]) -> Iterator[tuple[Claim, tuple[float, float]]]:
    """Yields what a policy earns by the oracle that was trained on our reward, as a share of one trained on its own.

    It counts where that one comes near the expert: two policies that earn nothing are alike, too. Beside it stands the
    interval of seeds that are resampled apart.
    """
    for task, name in _RATIOS.items():
        ours, oracle = _of_same_seeds(*(groups.get((task, OURS, reward), []) for reward in (LEARNED, ORACLE)))
        if not ours:
            continue
        own, theirs = _samples(ours, POINTS), _samples(oracle, POINTS)
        value, (low, high) = claims.mean(own) / claims.mean(theirs), claims.paired_ratio_interval(own, theirs)
        counts = claims.mean(_samples(oracle, RETURN)) >= _LEAST_ORACLE
        claim = Claim(
            claim=name,
            value=round(value, 4),
            low=round(low, 4),
            high=round(high, 4),
            seeds=len(ours),
            trials=len(own[0].totals),
            scale="full",
            baseline=round(claims.mean(theirs), 3),
            dissertation=1.0,
            target=_LEAST,
            met=len(ours) == _RATIO_SEEDS and counts and value >= _LEAST and low >= _LEAST_LOW,
            world_version=ours[0].world_version,
            command="python -m experiments run fig_4_6",
            minutes=round(sum(arm.minutes for arm in (*ours, *oracle)), 2),
        )
        yield claim, claims.ratio_interval(own, theirs)


def _of_same_seeds(*groups: Sequence[ArmResult]) -> list[list[ArmResult]]:
    """Returns the arms of each group whose seeds all groups have."""
    seeds = set.intersection(*({arm.seed for arm in arms} for arms in groups))
    return [[arm for arm in arms if arm.seed in seeds] for arms in groups]


def _return_claim(figure: str, group: Group, arms: Sequence[ArmResult], name: str, unit: float) -> Claim:
    task, tuning, reward = group
    return claims.claim_of(
        f"{task.removeprefix('blocks.')}_{tuning}_{reward}",
        arms,
        _samples(arms, name),
        unit=unit,
        seeds=len(arms),
        command=f"python -m experiments run {figure}",
    )


def _samples(arms: Sequence[ArmResult], name: str) -> list[Sample]:
    return [each.samples[name] for each in arms]


def _ratio_row(claim: Claim, apart: tuple[float, float]) -> tuple[str, ...]:
    ratio, other = f"{claim.value:.3f} [{claim.low:.3f}, {claim.high:.3f}]", f"[{apart[0]:.3f}, {apart[1]:.3f}]"
    return f"`{claim.claim}`", str(claim.seeds), ratio, other, f">= {claim.target}", "yes" if claim.met else "**no**"


def _row(group: Group, arms: Sequence[ArmResult]) -> tuple[str, ...]:
    cells = (
        _cell(arms, RETURN, _PER_CENT),
        *(f"{claims.mean(_samples(arms, name)):.1f}" for name in (POINTS, RANDOM)),
        _each(arms, RETURN, _PER_CENT),
    )
    return *group, str(len(arms)), *cells


def _classifiers(groups: dict[Group, list[ArmResult]]) -> Iterator[tuple[str, ...]]:
    for (task, _, reward), arms in groups.items():
        if reward == VICE:
            yield task, str(len(arms)), *(_cell(arms, name, _PER_CENT) for name in (TOLD_SUCCESS, TOLD_FAILURE))


def _cell(arms: Sequence[ArmResult], name: str, unit: float) -> str:
    low, high = claims.interval(_samples(arms, name))
    return f"{unit * claims.mean(_samples(arms, name)):.1f} [{unit * low:.1f}, {unit * high:.1f}]"


def _each(arms: Sequence[ArmResult], name: str, unit: float) -> str:
    return ", ".join(f"{unit * each.mean:.0f}" for each in _samples(arms, name))
