"""Policies of a robot's own exploration that follow demonstrations: an experiment for each world of chapter 3.

All arms of a world share their data and one goal recognizer, which a first pipeline makes once for all. A policy is
fitted once for two arms, one for each kind of settings.
"""

import json
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from experiments.chapter3 import followed_report, reach, sift
from experiments.chapter3.exploration import (
    DATA_OPTION,
    EXPERT,
    EXPLORING,
    POLICY,
    RANDOM_SEARCH,
    SIFT,
    Exploration,
    is_fitted,
)
from experiments.chapter3.followed import ACTING, GREEDY, samples
from experiments.chapter3.followed_report import Report
from experiments.workbench.arms import Arm, Experiment, world_version
from experiments.workbench.configs import Config
from experiments.workbench.pipelines import Trials, run_once, run_pipeline
from experiments.workbench.results import ArmResult, Outcome
from experiments.workbench.table import Table
from freerein.learning.model_files import MODEL, read_card
from freerein.model_store import ModelStore
from freerein.types.common import ModelRef


class Followers(Experiment):
    """An arm for each row, exploration, seed and kind of settings; random search, expert and ceiling have no fit.

    Args:
        exploration: The world.
        report: What its table claims.
    """

    def __init__(self, exploration: Exploration, report: Report) -> None:
        self.exploration = exploration
        self._report = report

    @property
    def arms(self) -> tuple[Arm, ...]:
        """Those of the exploration."""
        return self.exploration.arms

    def config(self, arm: Arm) -> Config:
        """Returns the steps of the pipeline that arms share, of the fit, and of the arm's own."""
        own = self.exploration
        fit = [own.fit_step(arm)] if is_fitted(arm.method) else []
        return {"version": own.version, "shared": list(own.shared), "fit": fit, "steps": list(own.steps(arm))}

    def prepare(self, arm: Arm, work: Path) -> bool:
        """Makes data and recognizer, or waits until another arm has made them."""
        return arm.method in (EXPERT, RANDOM_SEARCH, SIFT) or self._shared(work) is not None

    def run(
        self, arm: Arm, *, results: Path, work: Path, folder: Path, on_progress: Callable[[], None]
    ) -> Outcome | None:
        """Has a policy follow demonstrations by its likeliest actions, and by drawn ones; see `Experiment`."""
        if arm.method == EXPLORING:
            return self._explored(arm, work, folder)
        found: dict[str, Trials] = {}
        source = self._fitted(arm, work, on_progress) if is_fitted(arm.method) else None
        if is_fitted(arm.method) and source is None:
            return None
        modules = {"imitation": sift.MODULE} if arm.method == SIFT else {}
        if arm.method == SIFT:
            source = folder / "made"
            sift.publish(arm.world, source / "data", model_name=POLICY)
        for acting in ACTING if is_fitted(arm.method) else ACTING[:1]:
            if source and acting != GREEDY:
                publish_sampled(source / "data", folder / "drawn" / "data")
                source = folder / "drawn"
            steps = [*self.exploration.steps(arm)]
            trials = run_pipeline(steps, folder / acting, on_progress, source=source, modules=modules)
            if trials is None:
                return None
            found[acting] = trials
        return Outcome({}, dict(samples(found, self.exploration.settings_of(arm), self.exploration.figures)))

    def table(self, results: Sequence[ArmResult]) -> Table:
        """Returns a row for each fit that has results, and the claims."""
        return followed_report.table(self.exploration, results, report=self._report)

    def _explored(self, arm: Arm, work: Path, folder: Path) -> Outcome | None:
        """Measures how far the data of an arm reach."""
        made, own = self._shared(work), self.exploration
        if made is None:
            return None
        collected = own.collected(arm.options[DATA_OPTION])
        return Outcome(reach.measure(collected, places=own.places, made=made, folder=folder), {})

    def _fitted(self, arm: Arm, work: Path, on_progress: Callable[[], None]) -> Path | None:
        """Fits the policy of an arm, once for all arms that act by it, to data that are made once for all."""
        shared = self._shared(work)
        if shared is None:
            return None
        own = self.exploration
        made_by = {**self._made_by(), "shared": list(own.shared)}
        return run_once([own.fit_step(arm)], made_by, work / own.world, on_progress, source=shared)

    def _shared(self, work: Path) -> Path | None:
        own = self.exploration
        return run_once(own.shared, self._made_by(), work / own.world, lambda: None)

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
