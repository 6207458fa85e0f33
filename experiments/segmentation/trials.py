"""Trials: short fits of one method with several learning rates, of which the lowest validation loss chooses.

Rates are tried until the best lies between two others.

    <results>/trials/<world>-<method>-<context>.json

The loss is that of the training signal. Trials are run once, with seed 0, and are committed: all seeds of a method use
their choice.
"""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from experiments.segmentation.dataset import SplitSpec
from experiments.segmentation.study import SUPERVISED, Study
from experiments.workbench.arms import Arm, world_version
from experiments.workbench.cache_paths import cache_path
from experiments.workbench.configs import Config, is_same, to_json
from experiments.workbench.locks import locked
from freerein.atomic_files import write_atomic
from freerein.errors import FailedPrecondition
from freerein.learning.training_loop import TrainingFailed
from freerein_segmentation.training import SegmentationConfig

_OF_FINAL = ("final_objective", "final_share", "rounds", "switching_cost", "action_evidence", "tag_context")
_WITHOUT_FINAL: dict[str, Any] = {name: getattr(SegmentationConfig, name) for name in _OF_FINAL}
"""Trials end before the final objective begins: its loss is that of labels of its own, and so compares with none."""

_NO_TEST = SplitSpec(count=0, least_skills=0, most_skills=0)
"""Trials see no test data, so that more of these change no choice."""

Fit = Callable[[SegmentationConfig, Path], float | None]
"""Fits in a folder, or resumes; returns the lowest validation loss, None when it was stopped."""

_STEP = 3
"""A rate beyond those that were tried, relative to the nearest."""


def rank_lrs(study: Study, arm: Arm, fit: Fit, *, results: Path, work: Path) -> dict[float, float] | None:
    """Returns the learning rates for an arm, best first, and the loss of each one's trial; None when one was stopped.

    Rates whose trial failed are left out.

    Args:
        study: The arm's study.
        arm: An arm with a network.
        fit: Runs one trial.
        results: Folder of the experiment's results.
        work: Folder that all arms share; trials keep their checkpoints there.
    """
    config = _until_final(study.fit_config(replace(arm, seed=0)), steps=study.trial_steps)
    made_by: Config = {
        "fit": config,
        "supervised": arm.method == SUPERVISED,
        "data": replace(study.data, test=_NO_TEST),
        "learning_rates": study.learning_rates,
        "world_version": world_version(study.world),
        **({} if study.sees_frames(arm) else {"sees_frames": False}),
    }
    name = _trials_name(arm)
    path = results / "trials" / f"{name}.json"
    folder = cache_path(work / "trials", made_by)  # of all methods that differ only after their trials
    with locked(folder / "lock"):
        if path.is_file() and is_same((found := json.loads(path.read_bytes()))["made_by"], made_by):
            return _ranked(found)
        losses: dict[float, float] = {}
        while untried := _untried(losses, study.learning_rates):
            try:
                loss = fit(replace(config, lr=untried[0]), folder / f"lr-{untried[0]:g}")
            except TrainingFailed:
                loss = math.inf
            if loss is None:
                return None
            losses[untried[0]] = loss
        best = min(losses, key=losses.__getitem__)
        shown = {f"{lr:g}": round(losses[lr], 6) if math.isfinite(losses[lr]) else None for lr in sorted(losses)}
        made = {"made_by": to_json(made_by), "validation_loss": shown, "lr": best}
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(path, json.dumps(made, indent=2, allow_nan=False).encode() + b"\n")
        return _ranked(made)


def chosen_lr(arm: Arm, results: Path) -> float:
    """Returns the learning rate that the trials of an arm's method chose, from an experiment's folder of results.

    Raises:
        FailedPrecondition: They were not run.
    """
    path = results / "trials" / f"{_trials_name(arm)}.json"
    if not path.is_file():
        raise FailedPrecondition(
            f"The trials of {_trials_name(arm)} must have been run; they were not.",
            hint=f"Run: python -m experiments run {results.name} --only '{_trials_name(arm)}-seed0'.",
        )
    return float(json.loads(path.read_bytes())["lr"])


def ends_with_tags(config: SegmentationConfig) -> bool:
    """Returns whether the loss of a whole fit compares with that of its trial: there is no final objective."""
    return _until_final(config, steps=config.steps) == config


def _ranked(made: Mapping[str, Any]) -> dict[float, float]:
    losses = {float(lr): float(loss) for lr, loss in made["validation_loss"].items() if loss is not None}
    return {lr: losses[lr] for lr in sorted(losses, key=lambda lr: (lr != made["lr"], losses[lr]))}


def _untried(losses: Mapping[float, float], first: Sequence[float]) -> list[float]:
    """Returns the rates to try next, given the losses of those that were: the first ones, then what lies beyond."""
    if untried := [lr for lr in first if lr not in losses]:
        return untried
    best = min(losses, key=losses.__getitem__)
    beyond = {max(losses): best * _STEP, min(losses): best / _STEP}
    return [float(f"{beyond[best]:.2g}")] if best in beyond else []


def _until_final(config: SegmentationConfig, *, steps: int) -> SegmentationConfig:
    return replace(config, steps=steps, context=config.context_before_final, **_WITHOUT_FINAL)


def _trials_name(arm: Arm) -> str:
    return "-".join([arm.world, arm.method, *arm.options.values()])
