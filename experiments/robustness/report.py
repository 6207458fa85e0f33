"""The table of the benchmark: claims, every model under every condition, wordings, and states that policies visit."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType

from experiments.robustness import evaluated, policies, scenes, speed, visited_states, wordings
from experiments.robustness.heat_map import heat_map
from experiments.robustness.made_claims import Made, make_claims, processor_of, samples_of
from experiments.robustness.targets import BASELINE, OURS
from experiments.robustness.worlds import BLOCKS, DEMONSTRATED, SCATTERED, conditions
from experiments.segmentation.evaluation import FRAME_ACCURACY
from experiments.workbench import claims
from experiments.workbench.results import ArmResult
from experiments.workbench.table import Picture, Section, Table, words
from freerein_sim.worlds.tasks import tasks

_TITLE = "Robustness: every model under every condition"

_VARIANTS = (OURS, BASELINE)
_GUESSES = MappingProxyType({DEMONSTRATED: ("majority", "random"), SCATTERED: ("captions", "word_blind", "majority")})


@dataclass(frozen=True)
class _Column:
    """A column of the table of conditions.

    Attributes:
        group: What is measured.
        name: Of what.
        world: World of its arms.
        method: Their method.
        variant: Their variant; empty for arms without a fit.
        figure: Name of the figure after that of the condition.
        scale: What a figure is multiplied with, to be in per cent.
    """

    group: str
    name: str
    world: str
    method: str
    variant: str
    figure: str
    scale: float = 100.0

    @property
    def title(self) -> str:
        """Its heading."""
        return f"{self.group}, {self.name}"


def table(results: Sequence[ArmResult]) -> Table:
    """Returns the table of the arms that have results."""
    made = make_claims(results)
    columns = [each for each in _columns(results) if _arms(results, each)]
    return Table(
        title=_TITLE,
        text=words("robustness"),
        sections=(
            _claims_section(made),
            _conditions_section(results, columns),
            _absent_section(results),
            _wordings_section(results),
            _visited_section(results),
            _policies_section(results),
            _trainings_section(results),
            _speed_section(results),
        ),
        claims=tuple(each.claim for each in made),
        picture=Picture("Every model under every condition, per cent", partial(_picture, results, columns)),
    )


def _columns(results: Sequence[ArmResult]) -> Iterator[_Column]:
    groups = [("segmentation", DEMONSTRATED, "segmentation", FRAME_ACCURACY)]
    groups += [(f"reward, {each[-1]} blocks", SCATTERED, "reward", f"{each}.{scenes.BALANCED}") for each in BLOCKS]
    for title, world, method, figure in groups:
        yield from (_Column(title, variant, world, method, variant, figure) for variant in _VARIANTS)
        yield from (_Column(title, guess, world, guess, "", figure) for guess in _GUESSES[world])
    for world in sorted({each.world for each in results if each.method == "ppo"}):
        steps, title = tasks()[world].spec.max_episode_steps, world.partition(".")[2].replace("-", " ")
        yield _Column("PPO", title, world, "ppo", "", visited_states.RETURN, 100 / steps)


def _arms(results: Sequence[ArmResult], column: _Column) -> list[ArmResult]:
    wanted = (column.world, column.method, column.variant)
    return [each for each in results if (each.world, each.method, each.options.get("fit", "")) == wanted]


def _values(results: Sequence[ArmResult], columns: Sequence[_Column]) -> dict[tuple[str, str], float]:
    """Returns the mean over seeds by condition and column's title."""
    values = {}
    for column in columns:
        arms = _arms(results, column)
        for condition in conditions(column.world):
            name = f"{condition}.{column.figure}"
            if name in arms[0].samples:
                values[condition, column.title] = column.scale * claims.mean(samples_of(arms, name))
    return values


def _conditions(columns: Sequence[_Column]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(name for column in reversed(columns) for name in conditions(column.world)))


def _picture(results: Sequence[ArmResult], columns: Sequence[_Column]) -> bytes:
    groups: dict[str, list[str]] = {}
    for column in columns:
        groups.setdefault(column.group, []).append(column.name)
    return heat_map(_values(results, columns), rows=_conditions(columns), groups=groups, title=_TITLE)


def _claims_section(made: Sequence[Made]) -> Section:
    rows = []
    for each in made:
        claim, found = each.claim, each.worst if len(each.target.samples) > 1 or each.target.of_runs else ""
        of_runs = f" of {claim.trials} runs" if each.target.of_runs else ""
        interval = f"{claim.value:.4g} [{claim.low:.4g}, {claim.high:.4g}{of_runs}]"
        met = {True: "yes", False: "**no**", None: ""}[claim.met]
        beside = ("" if value is None else f"{value:.4g}" for value in (claim.baseline, claim.ceiling))
        measured = (each.target.text, _pooled(each.arms), interval, each.target.must_reach, met)
        rows.append((f"`{claim.claim}`", *measured, *beside, found))
    value = "value [95 % interval; of runs: median, range]"
    found = "the worst is, or the processor"
    header = ("claim", "what", "seeds by task", value, "must reach", "met", "baseline", "ceiling", found)
    return Section(header, tuple(rows), "Claims")


def _pooled(arms: Sequence[ArmResult]) -> str:
    """Returns the seeds of the arms whose trials are joined, by task."""
    seeds: dict[str, list[int]] = {}
    for each in arms:
        seeds.setdefault(each.world, []).append(each.seed)
    return "; ".join(f"{world}: {', '.join(map(str, sorted(of)))}" for world, of in sorted(seeds.items()))


def _conditions_section(results: Sequence[ArmResult], columns: Sequence[_Column]) -> Section:
    values = _values(results, columns)
    rows = [
        (condition, *(_cell(values.get((condition, column.title))) for column in columns))
        for condition in _conditions(columns)
    ]
    return Section(("condition", *(column.title for column in columns)), tuple(rows), "Conditions")


def _absent_section(results: Sequence[ArmResult]) -> Section:
    """Rewards of goals that name a block that is not on show."""
    columns = [
        _Column("", name, SCATTERED, method, variant, f"blocks-2.{scenes.ABSENT_REWARDED}")
        for name, method, variant in (*((each, "reward", each) for each in _VARIANTS), ("captions", "captions", ""))
    ]
    columns = [each for each in columns if _arms(results, each)]
    values = _values(results, columns)
    rows = [(name, *(_cell(values.get((name, each.title)), 2) for each in columns)) for name in conditions(SCATTERED)]
    header = ("condition", *(f"{each.name}, %" for each in columns))
    return Section(header, tuple(rows), "Scenes of 2 blocks in which a goal that names an absent one is rewarded")


def _wordings_section(results: Sequence[ArmResult]) -> Section:
    by_variant = {each: _arms(results, _Column("", "", SCATTERED, "reward", each, "")) for each in _VARIANTS}
    figures = (wordings.RECALL, wordings.FALSE_RATE)
    present = {variant: arms for variant, arms in by_variant.items() if arms}
    rows = [
        (name, *(_interval(arms, f"{name}.{figure}") for arms in present.values() for figure in figures))
        for name in wordings.CLASSES
    ]
    titles = (f"{variant}, {figure.replace('_', ' ')}" for variant in present for figure in figures)
    return Section(("class", *titles), tuple(rows), "Wordings, in nominal scenes of 2 and 4 blocks")


def _visited_section(results: Sequence[ArmResult]) -> Section:
    rows, figures = (
        [],
        (
            visited_states.PRECISION,
            visited_states.RECALL,
            visited_states.SHARE_TRUE,
            visited_states.FALSE_POSITIVE_RATE,
            visited_states.PRECISION_AT_SHARE,
        ),
    )
    for world in sorted({each.world for each in results} - {DEMONSTRATED, SCATTERED}):
        for variant in _VARIANTS:
            if arms := _arms(results, _Column("", "", world, "reward", variant, "")):
                rows.append((world, variant, *(_interval(arms, figure) for figure in figures)))
    if arms := [each for each in results if each.method == visited_states.METHOD]:
        for group in (visited_states.ALL, *visited_states.RELATIONS):
            named = (visited_states.of_group(group, figure) for figure in figures)
            rows.append((f"teachers, {group}", OURS, *(_interval(arms, name) for name in named)))
    header = (
        "task",
        "fit",
        "precision",
        "recall",
        "share of states in which the goal holds (precision of a constant reward)",
        "false positive rate",
        "precision if that share were 40 %",
    )
    return Section(header, tuple(rows), "Reward on states that PPO's policies visit")


def _policies_section(results: Sequence[ArmResult]) -> Section:
    """Policies that were fitted to augmented frames, under every condition in which they acted."""
    figures = {
        policies.SKILLS_AUGMENTED: (policies.RECIPE_SKILLS, policies.RECIPE_WHOLE),
        policies.GOAL_CLONING_AUGMENTED: (policies.LANDMARKS_FREE, policies.LANDMARKS_BLOCK, evaluated.FLAG_AUROC),
        policies.PPO_AUGMENTED: (policies.RETURN_ALL, policies.RETURN_WRONG_ORDER),
    }
    rows = []
    for world, method in sorted({(each.world, each.method) for each in results if each.method in figures}):
        arms = [each for each in results if (each.world, each.method) == (world, method)]
        for figure in figures[method]:
            names = [policies.under(condition, figure) for condition in policies.CONDITIONS]
            found = [_interval(arms, name) if all(name in each.samples for each in arms) else "" for name in names]
            rows.append((world, method, figure, str(len(arms)), *found))
    header = ("task", "method", "share", "seeds", *policies.CONDITIONS)
    return Section(header, tuple(rows), "Policies that were fitted to augmented frames, where they acted")


def _trainings_section(results: Sequence[ArmResult]) -> Section:
    """Every training by PPO: what the worst one is worth is no mean."""
    figures = (policies.RETURN_ALL, policies.RETURN_WRONG_ORDER)
    starts = {
        policies.PPO: "on the way",
        policies.PPO_AUGMENTED: "on the way; eye fitted to augmented frames",
        policies.PPO_NEAR: "gripper near; repeats of failures",
        policies.PPO_NEAR_CARRY: "gripper near, carrying shaped; repeats of failures",
        policies.PPO_OWN_STARTS: "the task's own",
        policies.PPO_PRACTICE: "the task's own, and practice",
    }
    rows = [
        (each.world, starts[each.method], str(each.seed), *(_share(each, name) for name in figures))
        for each in sorted(results, key=lambda each: (each.method, each.world, each.seed))
        if each.method in starts
    ]
    header = ("task", "training's starts", "seed", "all starts, % of the expert", "starts in the wrong order, %")
    return Section(header, tuple(rows), "PPO, every training")


def _share(result: ArmResult, name: str) -> str:
    return f"{100 * result.samples[name].mean:.1f}" if name in result.samples else ""


def _speed_section(results: Sequence[ArmResult]) -> Section:
    """Every run: none is replaced by another."""
    figures = (speed.TICKS_PER_S, speed.TICKS_PER_S_HELD, speed.NETWORK_VS_IN_PROCESS)
    rows = [
        (
            str(each.seed),
            processor_of(each),
            *(f"{each.samples[name].mean:.4g}" if name in each.samples else "" for name in figures),
        )
        for each in results
        if each.method == policies.PPO_SPEED
    ]
    header = ("run", "processor", "control ticks per second", "actions held for two ticks", "of those in one process")
    return Section(header, tuple(rows), "Speed of PPO on the learned reward, every run")


def _interval(arms: Sequence[ArmResult], name: str) -> str:
    found = samples_of(arms, name)
    low, high = claims.interval(found)
    return f"{claims.mean(found):.3f} [{low:.3f}, {high:.3f}]"


def _cell(value: float | None, decimals: int = 1) -> str:
    return "" if value is None else f"{value:.{decimals}f}"
