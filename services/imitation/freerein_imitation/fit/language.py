"""A fit of a language policy: the distillation of section 4.3."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import torch

from freerein.data import Dataset, read_teachers
from freerein.data.lookup import choose_camera
from freerein.errors import InvalidInput
from freerein.jobs.child import stop_on_sigterm
from freerein.learning.fit import FitResult, fit
from freerein.learning.model_files import choose_device
from freerein_imitation.fit.source import Source, timestep
from freerein_imitation.model import Handshake, LanguageNetwork, LanguagePolicy, language_policy
from freerein_imitation.model.text_tower import TextTower
from freerein_imitation.training import language
from freerein_imitation.training.exploration import Exploration
from freerein_imitation.training.language import LanguageConfig, LanguageLearner, minilm

_TEXTS_IN_CARD = 64


def resolve(source: Source, values: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the whole configuration of a fit on a dataset.

    Raises:
        InvalidInput: The configuration is wrong, or the dataset cannot be learned from.
        FailedPrecondition: There is no text tower.
    """
    config = LanguageConfig.from_mapping(values)
    config = replace(config, camera=choose_camera(source.dataset, config.camera))
    minilm.check()
    untold = source.dataset.goal_texts.count("")
    if untold:
        raise InvalidInput(
            f"Every trajectory must have a goal text; {untold} of {len(source.dataset)} have none.",
            field="dataset",
            hint="Record each with what was to be done, in words.",
        )
    language.design(config, timestep(source.dataset, config.camera), action_choices=source.dataset.spec.action.choices)
    longest = int(source.dataset.lengths.max(initial=1))
    return asdict(replace(config, max_steps_per_goal=config.max_steps_per_goal or longest))


def train(folder: Path, source: Source, values: Mapping[str, Any], device: str) -> bool:
    """Writes the model into the fit's folder and returns True, or returns False when it was stopped before."""
    tower = minilm.read()
    learner = _learner(source.dataset, tower, LanguageConfig.from_mapping(values), device)
    with stop_on_sigterm() as stop:
        fitted = fit(learner, folder, stop=stop)
    if fitted is None:
        return False
    card = {**_card(source.dataset, learner, fitted), **supervision_of(read_teachers(source.root))}
    language_policy.save(fitted.network, tower, folder / "model", name=minilm.NAME, card=card)
    return True


def _learner(dataset: Dataset, tower: bytes, config: LanguageConfig, device: str) -> LanguageLearner:
    torch.set_num_threads(config.threads)
    return language.prepare(
        config,
        Exploration(dataset.cached_frames(config.camera), dataset.cached_actions()),
        dataset.goal_texts,
        TextTower(tower),
        action_choices=dataset.spec.action.choices,
        fingerprint=f"{dataset.fingerprint} {hashlib.sha256(tower).hexdigest()}",
        device=choose_device(device),
    )


def _card(dataset: Dataset, learner: LanguageLearner, fitted: FitResult[LanguageNetwork]) -> dict[str, Any]:
    handshake = Handshake(
        action=dataset.spec.action,
        control_dt_s=1 / dataset.spec.fps,
        reached_threshold=LanguagePolicy.reached_threshold,
        max_steps_per_goal=learner.config.max_steps_per_goal,
    )
    different = sorted(set(dataset.goal_texts))
    return {
        "kind": LanguagePolicy.kind,
        **handshake.to_card(),
        "command": "freerein fit imitation DATASET --set policy=language",
        "task": dataset.spec.task,
        "data": {"trajectories": len(dataset), "fingerprint": dataset.fingerprint},
        "goal_texts": {"count": len(different), "first": different[:_TEXTS_IN_CARD]},
        "config": asdict(learner.config),
        "figures": {
            "validation_loss": fitted.validation_loss,
            "best_step": fitted.best_step,
            "action_loss": fitted.validation_loss,
        },
    }


def supervision_of(told: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Returns what a card tells of the supervision: a dataset's, and that of the policies that acted in it, if any."""
    supervision = "images, executed actions and goal texts"
    if told:
        theirs = sorted({str(teacher.get("supervision") or "unknown") for teacher in told})
        supervision += f" of policies with this supervision: {'; or: '.join(theirs)}"
    return {"supervision": supervision, "privileged": any(teacher.get("privileged") is True for teacher in told)}
