"""What differs between the worlds of chapter 3: data, rows, and the settings in which demonstrations are followed."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from experiments.robustness.evaluated import evaluate
from experiments.workbench.arms import Arm
from experiments.workbench.pipelines import Step, step

EXPERT, RANDOM_SEARCH, TRUE_SWITCHING = "expert", "random_search", "true_switching"
SIFT = "sift"
"""Follows by matching features, and learns nothing."""

EXPLORING = "exploring"
"""What made the data, which follows nothing: how much it explored, and how far it gets."""

PILOT = "pilot"
"""A short fit at one learning rate, which follows nothing."""

CEILINGS = (EXPERT, TRUE_SWITCHING)

CHOICE, TEST = "choice", "test"
"""Kinds of settings: those that choose between greedy and sampled actions, and those of claims."""

FOLLOWED = ("steps", "farthest_at", "failed.flag", "failed.blocked", "failed.lost")
"""Figures of how a trial went: its actions, those up to the farthest landmark, and why the next one was not reached."""

RECOGNIZER, POLICY = "recognizer", "policy"
DATA_OPTION, SETTINGS_OPTION, FIT_OPTION, RATE_OPTION = "data", "settings", "fit", "rate"

_PILOT_STEPS = 1000


@dataclass(frozen=True)
class Choice:
    """What chooses between greedy and sampled actions, for each fit: the better figure in a setting.

    Attributes:
        setting: One of those that choose.
        figure: Of its trials.
        statistic: Of the figure, as that of the claim is; of equals the one with the better mean.
        is_less: Whether a smaller figure is better.
    """

    setting: str
    figure: str
    statistic: Literal["mean", "median"] = "mean"
    is_less: bool = False


@dataclass(frozen=True)
class Setting:
    """Demonstrations that are followed under one condition.

    Attributes:
        evaluations: Configuration of each evaluation, beside its policy. Several follow demonstrations of their own;
            their trials are taken in turn.
        demonstrations: Of all together: trial i follows that of number i modulo their number.
        choice: What chooses the way of acting here.
    """

    evaluations: Sequence[Mapping[str, Any]]
    demonstrations: int
    choice: Choice

    def names(self, name: str) -> list[str]:
        """Returns the names of the steps that evaluate it, given its own."""
        several = len(self.evaluations) > 1
        return [f"{name}_{number}" if several else name for number in range(len(self.evaluations))]


@dataclass(frozen=True, kw_only=True)
class Exploration:
    """A world of chapter 3 as it is explored, learned and evaluated.

    Attributes:
        world: Its task, which names the experiment.
        version: Raised where its results are made otherwise.
        collects: Steps that make the data of each exploration, datasets of its name.
        timesteps: Actions with an image before and after that the dissertation's networks learned from.
        recognizer: Configuration of the fit of the goal recognizer, to the data that claims rest on.
        fit: Configuration that all fits of policies have.
        rows: What each row's fit has beside that.
        lr: Learning rate by fit, of the recognizer and of rows, that a pilot chose; rows that are not among them have
            the last one.
        rates: Learning rates that the pilot tries, by fit.
        seeds: Number of fits of each row to the data of each exploration.
        claimed: Row and data that claims rest on, and whose policy has the ceiling of true switching.
        settings: By kind and name.
        figures: Of each trial; numbers, or lists by landmark, of which the mean counts.
        sift: Settings that the row `sift` has, by kind and name; empty where there is no such row.
        places: Numbers of a true state, the first ones, that say where the robot is; 0 where it stays where it is.
        switching: What takes fitted policies to the next landmark; see `evaluate`.
        truth: What evaluations of true switching have beside those of others.
        counts_knots: Whether knots are counted among the data.
    """

    world: str
    version: int
    collects: Sequence[Step]
    timesteps: int
    recognizer: Mapping[str, Any]
    fit: Mapping[str, Any]
    rows: Mapping[str, Mapping[str, Any]]
    lr: Mapping[str, float]
    rates: Mapping[str, Sequence[float]]
    seeds: Mapping[str, Mapping[str, int]]
    claimed: tuple[str, str]
    settings: Mapping[str, Mapping[str, Setting]]
    figures: Sequence[str]
    sift: Mapping[str, Mapping[str, Setting]] = field(default_factory=dict)
    places: int = 0
    switching: str = "policy"
    truth: Mapping[str, Any] = field(default_factory=dict)
    counts_knots: bool = False

    @property
    def arms(self) -> tuple[Arm, ...]:
        """Data and learning rates, then the settings that choose, then those of the tests.

        In each what needs no fit is first, then are all fits of a seed before those of the next. The ceiling of true
        switching comes after those of seed 0, one of which it shares: two arms at a time do not wait for one fit.
        """
        explored = [Arm(self.world, EXPLORING, {DATA_OPTION: data}) for data in self.seeds]
        pilots = [
            Arm(self.world, PILOT, {FIT_OPTION: fit, RATE_OPTION: f"{rate:g}"})
            for fit, rates in self.rates.items()
            for rate in rates
        ]
        followers = [
            Arm(self.world, row, {**({DATA_OPTION: data} if data else {}), SETTINGS_OPTION: settings}, seed)
            for settings in self.settings
            for row, data, seed in self._followers()
        ]
        return (*explored, *pilots, *followers)

    def _followers(self) -> Iterator[tuple[str, str, int]]:
        """Yields rows, their data and seeds in the order in which they run."""
        yield from ((row, "", 0) for row in (EXPERT, RANDOM_SEARCH, *([SIFT] if self.sift else [])))
        rows = [(data, row, seeds) for data, rows in self.seeds.items() for row, seeds in rows.items()]
        for seed in range(max(seeds for _, _, seeds in rows)):
            yield from ((row, data, seed) for data, row, seeds in rows if seed < seeds)
            if not seed:
                yield TRUE_SWITCHING, self.claimed[1], 0

    def collected(self, data: str) -> Mapping[str, Any]:
        """Returns the configuration of the run that collects the data of an exploration."""
        config: Mapping[str, Any] = next(each["config"] for each in self.collects if each["name"] == data)
        return config

    @property
    def all_settings(self) -> dict[str, Setting]:
        """Settings of all kinds, by name."""
        kinds = [*self.settings.values(), *self.sift.values()]
        return {name: setting for of_kind in kinds for name, setting in of_kind.items()}

    def settings_of(self, arm: Arm) -> Mapping[str, Setting]:
        """Returns the settings in which an arm follows demonstrations, by name."""
        return (self.sift if arm.method == SIFT else self.settings).get(arm.options.get(SETTINGS_OPTION, ""), {})

    def is_reduced(self, row: str) -> bool:
        """Returns whether a row has fewer updates than others."""
        steps: int = self.rows.get(row, {}).get("steps", self.fit["steps"])
        return bool(steps < self.fit["steps"])

    def recognizer_step(self, **config: Any) -> Step:
        """Returns the step that fits the goal recognizer of all rows."""
        config = {"method": "goal_recognizer", **self.recognizer, "lr": self.lr[RECOGNIZER], **config}
        return _fit(RECOGNIZER, self.claimed[1], config)

    def fit_step(self, arm: Arm, **config: Any) -> Step:
        """Returns the step that fits the policy of an arm; that of true switching is the one that claims rest on."""
        name = self.claimed[0] if arm.method == TRUE_SWITCHING else arm.options.get(FIT_OPTION, arm.method)
        row, lr = self.rows[name], self.lr.get(name, [*self.lr.values()][-1])
        named = {} if row.get("stop") else {"recognizer": RECOGNIZER}
        config = {"method": "goal_conditioned", "seed": arm.seed, **named, **self.fit, "lr": lr, **row, **config}
        return _fit(POLICY, arm.options.get(DATA_OPTION, self.claimed[1]), config)

    def pilot_steps(self, arm: Arm) -> list[Step]:
        """Returns the steps of a short fit at one learning rate; no loss of a policy depends on its recognizer."""
        lr = float(arm.options[RATE_OPTION])
        if arm.options[FIT_OPTION] == RECOGNIZER:
            return [self.recognizer_step(lr=lr, steps=_PILOT_STEPS)]
        return [self.recognizer_step(lr=lr, steps=1), self.fit_step(arm, lr=lr, steps=_PILOT_STEPS)]

    def steps(self, arm: Arm, names: Collection[str] | None = None) -> Iterator[Step]:
        """Yields the steps that evaluate an arm, for each of its settings, or for those of some names."""
        policy = {EXPERT: "expert", RANDOM_SEARCH: "random"}.get(arm.method, {"model": POLICY})
        more: dict[str, Any] = {}
        if is_fitted(arm.method):
            is_true = arm.method == TRUE_SWITCHING
            more = {**self.truth, "switching": "truth"} if is_true else {"switching": self.switching}
        for name, setting in self.settings_of(arm).items():
            if names is None or name in names:
                for each, config in zip(setting.names(name), setting.evaluations, strict=True):
                    made = evaluate("demonstrations", each, policy=policy)
                    yield {**made, "config": {**made["config"], **config, **more}}


def is_fitted(method: str) -> bool:
    """Returns whether a row has a policy that is fitted."""
    return method not in (EXPERT, RANDOM_SEARCH, SIFT, EXPLORING, PILOT)


def _fit(name: str, data: str, config: Mapping[str, Any]) -> Step:
    return step(name, "fit", service="imitation", dataset=data, model_name=name, config=config)
