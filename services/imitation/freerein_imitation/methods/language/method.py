"""The method `language`."""

import json
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import torch

from freerein.data import read_teachers
from freerein.errors import InvalidInput
from freerein.goal_text import Grammar
from freerein.learning.actor_critic import shared_object_encoder
from freerein.learning.actor_critic.object_encoder import OBJECT_ENCODER
from freerein.learning.actor_critic.shared_object_encoder import SharedObjectEncoder
from freerein.learning.fit_dataset import FitDataset
from freerein.learning.inputs import spec_of
from freerein.learning.methods import Method
from freerein.learning.training_loop import FitResult
from freerein_imitation.methods.language.config import LanguageConfig
from freerein_imitation.methods.language.losses import LanguageLearner
from freerein_imitation.methods.language.network import LanguageNetwork, LanguageSpec
from freerein_imitation.methods.language.policy import TEXT_ENCODER_FILE, TEXTS_FILE, LanguagePolicy, text_encoder_entry
from freerein_imitation.methods.language.recognizer import least_probability
from freerein_imitation.methods.language.texts import minilm
from freerein_imitation.methods.shared.supervision import supervision_of
from freerein_imitation.model.policy import NEVER_REACHED, ControlSpec

_TEXTS_IN_CARD = 64


def _check(source: FitDataset, config: LanguageConfig) -> None:
    dataset = source.dataset
    minilm.check()
    missing = dataset.goal_texts.count("")
    if missing:
        raise InvalidInput(
            f"Every trajectory must have a goal text; {missing} of {len(dataset)} have none.",
            field="dataset",
            hint="Record each trajectory with its goal text.",
        )
    spec_of(config, LanguageSpec, cameras=source.cameras(config.cameras), action=dataset.spec.action)
    _find_encoder(source, config)


def _complete(source: FitDataset, config: LanguageConfig) -> LanguageConfig:
    longest = int(source.dataset.lengths.max(initial=1))
    return replace(config, max_steps_per_goal=config.max_steps_per_goal or longest)


def _find_encoder(source: FitDataset, config: LanguageConfig) -> tuple[SharedObjectEncoder, dict[str, Any]] | None:
    """Returns the object encoder of the policies that acted in a dataset, and its card; None for another encoder.

    Raises:
        InvalidInput: They had none, or it is of another camera, or a goal text relates no two things that it locates.
    """
    if config.encoder != OBJECT_ENCODER:
        return None
    folder = source.root / shared_object_encoder.FOLDER
    if not folder.is_dir():
        raise shared_object_encoder.no_object_encoder()
    encoder, card = shared_object_encoder.load_object_encoder(folder)
    if config.cameras != (card["camera"],):
        raise InvalidInput(
            f"The object encoder sees the camera {card['camera']}; the student is to see {', '.join(config.cameras)}.",
            field="config.cameras",
            hint="Leave them out, or choose an image encoder.",
        )
    phrases = encoder.spec.phrases
    known = Grammar(phrases, phrases)
    unread = [text for text in sorted(set(source.dataset.goal_texts)) if known.read(text).statement is None]
    if unread:
        raise InvalidInput(
            f"With an object encoder each goal text must relate two of: {', '.join(phrases)}; {len(unread)} do not.",
            field="config.encoder",
            hint="Choose an image encoder.",
        )
    return encoder, card


def _prepare(source: FitDataset, config: LanguageConfig, device: torch.device) -> LanguageLearner:
    found = _find_encoder(source, config)
    return LanguageLearner.prepare(
        config,
        source.trajectories(config.cameras),
        minilm.read(),
        cameras=source.cameras(config.cameras),
        action=source.dataset.spec.action,
        fingerprint=source.dataset.fingerprint,
        device=device,
        object_encoder=found[0] if found else None,
    )


def _card(source: FitDataset, learner: LanguageLearner, fitted: FitResult[LanguageNetwork]) -> dict[str, Any]:
    texts = sorted(set(source.dataset.goal_texts))
    threshold, figures = _reached(learner, fitted.network)
    found = _find_encoder(source, learner.config)
    return {
        **ControlSpec(source.dataset.spec.control_dt_s, threshold, learner.config.max_steps_per_goal).to_card(),
        "figures": {**fitted.figures, "action_loss": fitted.validation_loss, **figures},
        "goal_texts": {"count": len(texts), "first": texts[:_TEXTS_IN_CARD]},
        **supervision_of(_supervision(is_judged=learner.spec.predicts_reached), read_teachers(source.root)),
        **text_encoder_entry(minilm.NAME, learner.text_encoder),
        **({"eye": {"model": found[1]["model"], "locates": list(found[0].spec.phrases)}} if found else {}),
    }


def _reached(learner: LanguageLearner, network: LanguageNetwork) -> tuple[float, dict[str, float]]:
    """Returns the probability from which on a goal counts as reached, and what is known of it on held-out frames.

    They are the frames that it was chosen on: figures on others are lower.
    """
    if network.recognizer is None:
        return NEVER_REACHED, {}
    logits, shown = learner.held_out_reached(network)
    probabilities = network.recognizer.probability(logits)
    threshold = least_probability(probabilities, shown)
    said = probabilities >= threshold
    return threshold, {
        "reached_share": shown.double().mean().item(),
        "reached_recall": (said & shown).sum().item() / max(1, shown.sum().item()),
        "reached_precision": (said & shown).sum().item() / max(1, said.sum().item()),
    }


def _files(learner: LanguageLearner) -> Mapping[str, bytes]:
    texts = sorted(learner.training.codes)
    return {TEXT_ENCODER_FILE: learner.text_encoder, TEXTS_FILE: json.dumps(texts).encode()}


def _supervision(*, is_judged: bool) -> str:
    """Returns the supervision by the dataset; `is_judged`: a learned reward chose the frames that show the goal."""
    judged = ", and which frames a learned reward rewards," if is_judged else ""
    return f"images, executed actions and goal texts{judged}"


METHOD = Method(LanguageConfig, _check, _prepare, _card, LanguagePolicy.load, complete=_complete, files=_files)
