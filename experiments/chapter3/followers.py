"""Policies of a robot's own exploration that follow demonstrations: an experiment for each world of chapter 3.

All arms of a world share their data and one goal recognizer, which two pipelines make once for all: learning rates are
tried between them. A policy is fitted once for two arms, one for each kind of settings.
"""

import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from experiments.chapter3 import fits, followed_report, knots, reach, sift
from experiments.chapter3.exploration import (
    CHOICE,
    DATA_OPTION,
    EXPLORING,
    PILOT,
    POLICY,
    SETTINGS_OPTION,
    SIFT,
    TEST,
    Exploration,
    is_fitted,
)
from experiments.chapter3.followed import ACTING, GREEDY, chosen_acting, samples
from experiments.chapter3.followed_report import Report
from experiments.workbench.arms import Arm, Experiment, is_current, world_version
from experiments.workbench.configs import Config
from experiments.workbench.pipelines import Step, Trials, run_once, run_pipeline
from experiments.workbench.results import ArmResult, Outcome, load
from experiments.workbench.table import Table
from freerein.atomic_files import write_atomic
from freerein.data import Dataset, dataset_path
from freerein.errors import FailedPrecondition
from freerein.learning.checkpoints import JSON
from freerein.learning.model_files import MODEL, read_card
from freerein.model_store import ModelStore
from freerein.types.common import ModelRef


class Followers(Experiment):
    """An arm for each row, exploration, seed and kind of settings; random search, expert and ceiling have no fit.

    Args:
        exploration: The world.
        report: What its table claims.
        others: Other worlds, whose flags its table compares with its own.
    """

    def __init__(self, exploration: Exploration, report: Report, others: "Sequence[Followers]" = ()) -> None:
        self.exploration = exploration
        self.report = report
        self._others = others

    @property
    def arms(self) -> tuple[Arm, ...]:
        """Those of the exploration."""
        return self.exploration.arms

    @property
    def sources(self) -> Sequence[str]:
        """The other worlds."""
        return [each.exploration.world for each in self._others]

    def config(self, arm: Arm) -> Config:
        """Returns the steps that make data and recognizer, that fit and that evaluate, where an arm has them.

        What is evaluated of a test may be less: see `run`.
        """
        own, fit = self.exploration, list[Step]()
        shared = [*own.collects] if arm.method in (EXPLORING, PILOT) or is_fitted(arm.method) else []
        if arm.method == PILOT:
            fit = own.pilot_steps(arm)
        elif is_fitted(arm.method):
            shared, fit = [*shared, own.recognizer_step()], [own.fit_step(arm)]
        figures = list(own.figures) if SETTINGS_OPTION in arm.options else []
        steps = list(own.steps(arm))
        return {"version": own.version, "shared": shared, "fit": fit, "steps": steps, "figures": figures}

    def prepare(self, arm: Arm, work: Path) -> bool:
        """Makes data and recognizer, or waits until another arm has made them."""
        if arm.method in (EXPLORING, PILOT):
            return self._collected(work) is not None
        return not is_fitted(arm.method) or self._recognizer(work) is not None

    def run(
        self, arm: Arm, *, results: Path, work: Path, folder: Path, on_progress: Callable[[], None]
    ) -> Outcome | None:
        """Has a policy follow demonstrations by its likeliest actions, and by drawn ones; see `Experiment`.

        In the tests a row that is not claimed acts in the way alone that its fit chose, if the result of that is there.
        """
        if arm.method == EXPLORING:
            return self._explored(arm, work, folder)
        if arm.method == PILOT:
            return self._tried(arm, work, folder, on_progress)
        found: dict[str, Trials] = {}
        source = self._fitted(arm, work, on_progress) if is_fitted(arm.method) else None
        if is_fitted(arm.method) and source is None:
            return None
        made = self._figures(arm, work, source) if source else {}
        shown = self._shown(arm, work, source) if source else {}
        self._check_one_policy(arm, results, shown)
        modules = {"imitation": sift.MODULE} if arm.method == SIFT else {}
        if arm.method == SIFT:
            source = folder / "made"
            sift.publish(arm.world, source / "data", model_name=POLICY)
        for acting, names in self._acting(arm, results, folder).items():
            if source and acting != GREEDY:
                publish_sampled(source / "data", folder / "drawn" / "data")
                source = folder / "drawn"
            steps = [*self.exploration.steps(arm, names)]
            trials = run_pipeline(steps, folder / acting, on_progress, source=source, modules=modules)
            if trials is None:
                return None
            found[acting] = trials
        measured = dict(samples(found, self.exploration.settings_of(arm), self.exploration.figures))
        return Outcome(made, measured, shown)

    def table(self, results: Sequence[ArmResult]) -> Table:
        """Returns a row for each fit that has results, and the claims."""
        others = [(each.exploration, each.report) for each in self._others]
        return followed_report.table(self.exploration, results, report=self.report, others=others)

    def _acting(self, arm: Arm, results: Path, folder: Path) -> dict[str, list[str]]:
        """Returns names of settings by the way of acting, greedy first; a resumed arm has those that it began with."""
        path = folder / "acting.json"
        if not path.exists():
            write_atomic(path, json.dumps(self._choose_acting(arm, results)).encode())
        found: dict[str, list[str]] = json.loads(path.read_bytes())
        return found

    def _choose_acting(self, arm: Arm, results: Path) -> dict[str, list[str]]:
        settings = self.exploration.settings_of(arm)
        if not is_fitted(arm.method):
            return {GREEDY: [*settings]}
        is_claimed = (arm.method, arm.options[DATA_OPTION]) == self.exploration.claimed
        result = self._chose(arm, results)
        if arm.options[SETTINGS_OPTION] != TEST or is_claimed or result is None:
            return {acting: [*settings] for acting in ACTING}
        chosen = {name: chosen_acting(result.samples, setting.choice) for name, setting in settings.items()}
        named = {acting: [name for name in settings if chosen[name] in (acting, "")] for acting in ACTING}
        return {acting: names for acting, names in named.items() if names}

    def _explored(self, arm: Arm, work: Path, folder: Path) -> Outcome | None:
        """Measures how much the data of an arm hold, and how far they reach."""
        made, own = self._collected(work), self.exploration
        if made is None:
            return None
        collected = own.collected(arm.options[DATA_OPTION])
        figures = reach.amounts(collected, made=made)
        if own.places:
            figures |= reach.measure(collected, places=own.places, made=made, folder=folder)
        if own.counts_knots:
            figures |= knots.count(collected, Dataset(dataset_path(made / "data", collected["dataset"])))
        return Outcome(figures, {})

    def _tried(self, arm: Arm, work: Path, folder: Path, on_progress: Callable[[], None]) -> Outcome | None:
        """Fits for a while at the learning rate of an arm."""
        made, steps = self._collected(work), self.exploration.pilot_steps(arm)
        if made is None or run_pipeline(steps, folder, on_progress, source=made, keeps_datasets=True) is None:
            return None
        figures = dict(fits.figures(folder, steps[-1]))
        shutil.rmtree(folder / "data" / "datasets")
        return Outcome(figures, {})

    def _figures(self, arm: Arm, work: Path, fitted: Path) -> dict[str, float]:
        """Returns what the fits of an arm came to: its own, and the recognizer's."""
        recognizer = self._recognizer(work)
        shared = fits.figures(recognizer, self.exploration.recognizer_step()) if recognizer else ()
        return dict([*fits.figures(fitted, self.exploration.fit_step(arm)), *shared])

    def _shown(self, arm: Arm, work: Path, fitted: Path) -> dict[str, JSON]:
        """Returns the versions of an arm's policy and of the recognizer, and the fingerprint of the policy's data."""
        recognizer = self._recognizer(work)
        shared = fits.made_of(recognizer, self.exploration.recognizer_step()) if recognizer else {}
        return {**shared, **fits.made_of(fitted, self.exploration.fit_step(arm))}

    def _check_one_policy(self, arm: Arm, results: Path, shown: Mapping[str, JSON]) -> None:
        """Raises FailedPrecondition where another policy than that of an arm of tests has chosen how it acts.

        Fits may differ between machines.
        """
        chose = self._chose(arm, results) if arm.options.get(SETTINGS_OPTION) == TEST else None
        if chose is not None and chose.shown.get(POLICY) != shown.get(POLICY):
            raise FailedPrecondition(
                f"One policy must have the results of {arm.name} and of {chose.name}; the latter are of version "
                f"{chose.shown.get(POLICY)}, not {shown.get(POLICY)}.",
                hint=f"Delete the result of {chose.name} and run it again, before the tests.",
            )

    def _chose(self, arm: Arm, results: Path) -> ArmResult | None:
        """Returns the current result of the settings that choose for an arm, if there is one."""
        chose = replace(arm, options={**arm.options, SETTINGS_OPTION: CHOICE})
        path = results / f"{chose.name}.json"
        result = load(path) if path.exists() else None
        return result if result is not None and is_current(self, chose, result) else None

    def _fitted(self, arm: Arm, work: Path, on_progress: Callable[[], None]) -> Path | None:
        """Fits the policy of an arm, once for all arms that act by it, to data that are made once for all."""
        own, shared = self.exploration, self._recognizer(work)
        if shared is None:
            return None
        made_by = {**self._made_by(), "shared": [*own.collects, own.recognizer_step()]}
        return run_once([own.fit_step(arm)], made_by, work / own.world, on_progress, source=shared)

    def _recognizer(self, work: Path) -> Path | None:
        """Fits the recognizer that all rows share, beside the data."""
        own, collected = self.exploration, self._collected(work)
        if collected is None:
            return None
        made_by = {**self._made_by(), "shared": [*own.collects]}
        return run_once([own.recognizer_step()], made_by, work / own.world, lambda: None, source=collected)

    def _collected(self, work: Path) -> Path | None:
        own = self.exploration
        return run_once(own.collects, self._made_by(), work / own.world, lambda: None)

    def _made_by(self) -> dict[str, Any]:
        return {"version": self.exploration.version, "world_version": world_version(self.exploration.world)}


def publish_sampled(fitted: Path, data_dir: Path) -> None:
    """Publishes the policy of one data directory in another, with a card that says that its actions are drawn."""
    made = ModelStore(fitted / "models" / "imitation")
    source = made.folder(ModelRef(POLICY, made.active_version(POLICY)))
    with TemporaryDirectory(dir=fitted) as staging:
        copy, card = Path(staging) / POLICY, read_card(source)
        copy.mkdir()
        shutil.copyfile(source / MODEL.weights, copy / MODEL.weights)
        (copy / MODEL.card).write_text(json.dumps({**card, "spec": {**card["spec"], "temperature": 1.0}}))
        store = ModelStore(data_dir / "models" / "imitation")
        store.activate(store.publish(POLICY, copy))
