"""Fit of a language policy: the distillation of section 4.3."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from freerein.data import read_teachers
from freerein.errors import InvalidInput
from freerein.learning.fit import FitResult
from freerein.learning.model_files import choose_device
from freerein_imitation.fit.dataset import FitDataset, fit_entries
from freerein_imitation.model import language
from freerein_imitation.model.language import LanguageNetwork, LanguagePolicy
from freerein_imitation.training import minilm
from freerein_imitation.training.language import LanguageConfig, LanguageLearner

_TEXTS_IN_CARD = 64


def resolve(source: FitDataset, values: Mapping[str, Any]) -> LanguageConfig:
    """Returns the complete configuration of a fit; raises as `freerein_imitation.fit.resolve`."""
    config, dataset = LanguageConfig.from_mapping(values), source.dataset
    minilm.check()
    missing = dataset.goal_texts.count("")
    if missing:
        raise InvalidInput(
            f"Every trajectory must have a goal text; {missing} of {len(dataset)} have none.",
            field="dataset",
            hint="Record each trajectory with its goal text.",
        )
    config.network_spec(source.sizes(config.camera))
    longest = int(dataset.lengths.max(initial=1))
    return replace(config, max_steps_per_goal=config.max_steps_per_goal or longest)


def prepare(source: FitDataset, values: Mapping[str, Any], device: str) -> LanguageLearner:
    """Returns the learner of a fit."""
    config = LanguageConfig.from_mapping(values)
    return LanguageLearner.prepare(
        config,
        source.sizes(config.camera),
        source.trajectories(config.camera),
        source.dataset.goal_texts,
        minilm.read(),
        fingerprint=source.dataset.fingerprint,
        device=choose_device(device),
    )


def save(folder: Path, source: FitDataset, learner: LanguageLearner, fitted: FitResult[LanguageNetwork]) -> None:
    """Writes the fitted model as a folder."""
    config, dataset, loss = learner.config, source.dataset, fitted.validation_loss
    texts = sorted(set(dataset.goal_texts))
    card = {
        "kind": LanguagePolicy.kind,
        **source.control(reached_threshold=language.NEVER_REACHED, max_steps_per_goal=config.max_steps_per_goal),
        "command": "freerein fit imitation DATASET --set policy=language",
        **fit_entries(source, config, fitted, fingerprint=dataset.fingerprint, action_loss=loss),
        "goal_texts": {"count": len(texts), "first": texts[:_TEXTS_IN_CARD]},
        **supervision_of(read_teachers(source.root)),
    }
    language.save(fitted.network, learner.text_encoder, folder, name=minilm.NAME, card=card)


def supervision_of(teacher_cards: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Returns the card's entries on supervision: the dataset's, and that of the policies that acted in it, if any."""
    supervision = "images, executed actions and goal texts"
    if teacher_cards:
        theirs = sorted({str(card.get("supervision") or "unknown") for card in teacher_cards})
        supervision += f" of policies with this supervision: {'; or: '.join(theirs)}"
    return {"supervision": supervision, "privileged": any(card.get("privileged") is True for card in teacher_cards)}
