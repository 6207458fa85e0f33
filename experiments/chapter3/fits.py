"""What fits come to: held-out losses beside that of a constant guess, and which learning rate is the best one tried.

Figures are named `<model>.<figure>`, such as `policy.validation_loss`.
"""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from experiments.chapter3.exploration import (
    DATA_OPTION,
    FIT_OPTION,
    PILOT,
    POLICY,
    RATE_OPTION,
    RECOGNIZER,
    TRUE_SWITCHING,
    Exploration,
)
from experiments.workbench.pipelines import Step, run_folder
from experiments.workbench.results import ArmResult
from experiments.workbench.table import Section
from freerein.data import Dataset, dataset_path
from freerein.learning.checkpoints import JSON
from freerein.learning.model_files import read_card
from freerein.model_store import ModelStore
from freerein.types.common import ModelRef
from freerein_imitation.methods.shared.action_heads import AUTO, head_of

LOSS, STEP = "validation_loss", "best_step"
HALFWAY = "validation_loss_halfway"
"""The lowest held-out loss in the first half of a fit: beside the last one it says whether the loss is flat."""

CONSTANT = "constant_loss"
"""The loss of the best constant guess: of actions by how often each occurs, of pairs that all are as likely close."""

THRESHOLD = "reached_threshold"
"""The recognizer's probability from which a goal counts as reached."""

_NAMED = (LOSS, STEP, "action_loss")
_LEAST_SHARE = 1e-12
_SHORT = 8
"""Characters of what is shown of a fingerprint."""


def figures(made: Path, fit: Step) -> Iterator[tuple[str, float]]:
    """Yields the figures of the fit that a step of a pipeline made.

    Args:
        made: Folder of the pipeline, which keeps its datasets.
        fit: The step.
    """
    name, config, card = fit["name"], fit["config"], _card(made, fit)
    yield from ((f"{name}.{figure}", card["figures"][figure]) for figure in _NAMED if figure in card["figures"])
    early = [loss for step, loss in _validated(made, fit) if 2 * step <= config["config"]["steps"]]
    if early:
        yield f"{name}.{HALFWAY}", min(early)
    if name == RECOGNIZER:
        yield f"{name}.{THRESHOLD}", card["control"][THRESHOLD]
    if not config["config"].get("stop"):  # whose held-out loss is of stopping, too
        yield f"{name}.{CONSTANT}", math.log(2) if name == RECOGNIZER else _constant_loss(made, config)


def made_of(made: Path, fit: Step) -> dict[str, JSON]:
    """Returns the version of the model that a step of a pipeline made, and the fingerprint of its data."""
    return {fit["name"]: _version(made, fit), "data": _card(made, fit)["data"]["fingerprint"]}


def best_rate(results: Sequence[ArmResult], fit: str) -> float:
    """Returns the learning rate at which a fit of the pilot had the lowest held-out loss."""
    tried = {float(each.options[RATE_OPTION]): _pilot_loss(each) for each in _pilots(results, fit)}
    return min(tried, key=tried.__getitem__)


def sections(exploration: Exploration, results: Sequence[ArmResult]) -> Iterator[Section]:
    """Yields held-out losses by learning rate in the pilot, and of each fit beside that of a constant guess."""
    rates = [f"{rate:g}" for rate in sorted({rate for each in exploration.rates.values() for rate in each})]
    pilots = [(fit, {each.options[RATE_OPTION]: each for each in _pilots(results, fit)}) for fit in exploration.lr]
    tried = [
        (
            fit,
            f"{exploration.lr[fit]:g}",
            *(f"{_pilot_loss(found[rate]):.4f}" if rate in found else "" for rate in rates),
        )
        for fit, found in pilots
        if found
    ]
    if tried:
        yield Section(("fit", "chosen", *rates), tuple(tried), "Held-out loss after 1 000 updates, by learning rate")
    if fitted := tuple(_fitted(results)):
        header = (
            *("row", "data", "seed", "model", "held-out loss", "halfway", "constant guess", "best update"),
            *("threshold", "version", "fingerprint of the data"),
        )
        yield Section(header, fitted, "Fits")


def _fitted(results: Sequence[ArmResult]) -> Iterator[tuple[str, ...]]:
    """Yields the cells of each policy, once, and of the recognizer that all share."""
    cells = {}
    for each in results:
        for model in (POLICY, RECOGNIZER) if each.method not in (PILOT, TRUE_SWITCHING) else ():
            if f"{model}.{LOSS}" in each.figures:
                row = (each.method, each.options[DATA_OPTION], str(each.seed)) if model == POLICY else ("all", "", "")
                cells[(*row, model)] = *_cells(model, each.figures), *_made_by(model, each)
    yield from ((*named, *cells[named]) for named in sorted(cells, key=lambda key: key[0] != "all"))


def _cells(model: str, found: Mapping[str, float]) -> tuple[str, ...]:
    known = [found.get(f"{model}.{figure}") for figure in (LOSS, HALFWAY, CONSTANT)]
    return *("" if each is None else f"{each:.4f}" for each in known), f"{found[f'{model}.{STEP}']:.0f}"


def _made_by(model: str, result: ArmResult) -> tuple[str, ...]:
    threshold = result.figures.get(f"{model}.{THRESHOLD}")
    named = [str(result.shown.get(name, ""))[:_SHORT] for name in (model, "data")]
    return "" if threshold is None else f"{threshold:.3f}", *named


def _pilots(results: Sequence[ArmResult], fit: str) -> list[ArmResult]:
    return [each for each in results if each.method == PILOT and each.options[FIT_OPTION] == fit]


def _pilot_loss(result: ArmResult) -> float:
    return result.figures[f"{RECOGNIZER if result.options[FIT_OPTION] == RECOGNIZER else POLICY}.{LOSS}"]


def _version(made: Path, fit: Step) -> str:
    return ModelStore(made / "data" / "models" / fit["config"]["service"]).active_version(fit["name"])


def _card(made: Path, fit: Step) -> dict[str, Any]:
    store = ModelStore(made / "data" / "models" / fit["config"]["service"])
    return read_card(store.folder(ModelRef(fit["name"], _version(made, fit))))


def _validated(made: Path, fit: Step) -> Iterator[tuple[int, float]]:
    """Yields the updates at which a fit was evaluated, and its held-out loss there."""
    started = run_folder(made) / "parts" / fit["name"] / "fit.json"
    path = made / "data" / "fits" / fit["config"]["service"] / json.loads(started.read_bytes())["id"] / "metrics.jsonl"
    for row in map(json.loads, path.read_bytes().splitlines()):
        if LOSS in row:
            yield row["step"], row[LOSS]


def _constant_loss(made: Path, config: Step) -> float:
    """Returns the action loss of one distribution for all frames, that of the actions in the data."""
    dataset = Dataset(dataset_path(made / "data", config["dataset"]))
    actions = torch.from_numpy(np.concatenate([dataset.actions(index) for index in range(len(dataset))]))
    head = head_of(config["config"].get("head", AUTO), dataset.spec.action)(1, dataset.spec.action, ())
    executed = head.target(actions)  # (N, D)
    guess = executed.mean(dim=0).clamp(min=_LEAST_SHARE).log()
    return float(head.loss(guess.expand_as(executed), executed).mean())
