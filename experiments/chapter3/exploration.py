"""What differs between the worlds of chapter 3: data, rows, and the settings in which demonstrations are followed."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from experiments.robustness.evaluated import evaluate
from experiments.workbench.arms import Arm
from experiments.workbench.pipelines import Step, step

EXPERT, RANDOM_SEARCH, TRUE_SWITCHING = "expert", "random_search", "true_switching"
SIFT = "sift"
"""Follows by matching features, and learns nothing."""

EXPLORING = "exploring"
"""What made the data, which follows nothing: how far it gets."""

CEILINGS = (EXPERT, TRUE_SWITCHING)

CHOICE, TEST = "choice", "test"
"""Kinds of settings: those that choose between greedy and sampled actions, and those of claims."""

RECOGNIZER, POLICY = "recognizer", "policy"
DATA_OPTION, SETTINGS_OPTION = "data", "settings"


@dataclass(frozen=True)
class Setting:
    """Demonstrations that are followed under one condition.

    Attributes:
        evaluations: Configuration of each evaluation, beside its policy. Several follow demonstrations of their own;
            their trials are taken in turn.
        demonstrations: Of all together: trial i follows that of number i modulo their number.
    """

    evaluations: Sequence[Mapping[str, Any]]
    demonstrations: int

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
        shared: Steps that make the data of each exploration, datasets of its name, and the goal recognizer.
        fit: Configuration that all fits have.
        rows: What each row's fit has beside that.
        seeds: Number of fits of each row to the data of each exploration.
        claimed: Row and data that claims rest on, and whose policy has the ceiling of true switching.
        settings: By kind and name.
        chooses: Setting and figure that choose between greedy and sampled actions.
        figures: Of each trial; numbers, or lists by landmark, of which the mean counts.
        sift: Settings of the tests that the row `sift` has, by name; empty where there is no such row.
        places: Numbers of a true state, the first ones, that say where the robot is; 0 where it stays where it is.
        switching: What takes fitted policies to the next landmark; see `evaluate`.
    """

    world: str
    version: int
    shared: Sequence[Step]
    fit: Mapping[str, Any]
    rows: Mapping[str, Mapping[str, Any]]
    seeds: Mapping[str, Mapping[str, int]]
    claimed: tuple[str, str]
    settings: Mapping[str, Mapping[str, Setting]]
    chooses: tuple[str, str]
    figures: Sequence[str]
    sift: Mapping[str, Setting] = field(default_factory=dict)
    places: int = 0
    switching: str = "policy"

    @property
    def arms(self) -> tuple[Arm, ...]:
        """What needs no fit, then all fits of a seed before those of the next; the settings of the tests are last."""
        rows = [(data, row, seeds) for data, rows in self.seeds.items() for row, seeds in rows.items()]
        fits = [
            (row, data, seed)
            for seed in range(max(seeds for _, _, seeds in rows))
            for data, row, seeds in rows
            if seed < seeds
        ]
        without = [(EXPERT, "", 0), (RANDOM_SEARCH, "", 0), (TRUE_SWITCHING, self.claimed[1], 0)]
        followers = (
            Arm(self.world, row, {**({DATA_OPTION: data} if data else {}), SETTINGS_OPTION: settings}, seed)
            for settings in self.settings
            for row, data, seed in [*without, *fits]
        )
        explored = [Arm(self.world, EXPLORING, {DATA_OPTION: data}) for data in self.seeds if self.places]
        classical = [Arm(self.world, SIFT, {SETTINGS_OPTION: TEST})] if self.sift else []
        return (*explored, *classical, *followers)

    def collected(self, data: str) -> Mapping[str, Any]:
        """Returns the configuration of the run that collects the data of an exploration."""
        config: Mapping[str, Any] = next(each["config"] for each in self.shared if each["name"] == data)
        return config

    @property
    def all_settings(self) -> dict[str, Setting]:
        """Settings of all kinds, by name."""
        found = {name: setting for of_kind in self.settings.values() for name, setting in of_kind.items()}
        return {**found, **self.sift}

    def settings_of(self, arm: Arm) -> Mapping[str, Setting]:
        """Returns the settings in which an arm follows demonstrations, by name."""
        kind = arm.options.get(SETTINGS_OPTION, "")
        return self.sift if arm.method == SIFT else self.settings.get(kind, {})

    def fit_step(self, arm: Arm) -> Step:
        """Returns the step that fits the policy of an arm; that of true switching is the one that claims rest on."""
        row = self.rows[self.claimed[0] if arm.method == TRUE_SWITCHING else arm.method]
        named = {} if row.get("stop") else {"recognizer": RECOGNIZER}
        config = {"method": "goal_conditioned", "seed": arm.seed, **named, **self.fit, **row}
        data = arm.options[DATA_OPTION]
        return step(POLICY, "fit", service="imitation", dataset=data, model_name=POLICY, config=config)

    def steps(self, arm: Arm) -> Iterator[Step]:
        """Yields the steps that evaluate an arm, for each of its settings."""
        policy = {EXPERT: "expert", RANDOM_SEARCH: "random"}.get(arm.method, {"model": POLICY})
        switching = {}
        if is_fitted(arm.method):
            switching = {"switching": "truth" if arm.method == TRUE_SWITCHING else self.switching}
        for name, setting in self.settings_of(arm).items():
            for each, config in zip(setting.names(name), setting.evaluations, strict=True):
                yield evaluate("demonstrations", each, policy=policy, **config, **switching)


def is_fitted(method: str) -> bool:
    """Returns whether a row has a policy that is fitted."""
    return method not in (EXPERT, RANDOM_SEARCH, SIFT, EXPLORING)


def recognizer_step(data: str, **config: Any) -> Step:
    """Returns the step that fits the goal recognizer of all rows."""
    config = {"method": "goal_recognizer", **config}
    return step(RECOGNIZER, "fit", service="imitation", dataset=data, model_name=RECOGNIZER, config=config)
