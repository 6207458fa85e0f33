"""The language-conditioned policy: a network, the text encoder that it was trained with, and the texts."""

import hashlib
import json
from collections.abc import Sequence
from copy import deepcopy
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from freerein.errors import InvalidInput
from freerein.learning import model_files
from freerein.learning.checkpoints import JSON
from freerein_imitation.methods.language.network import LanguageNetwork, LanguageSpec
from freerein_imitation.methods.language.texts.goal_text_codes import encode_text
from freerein_imitation.methods.language.texts.text_encoder import TextEncoder
from freerein_imitation.model.policy import ControlSpec
from freerein_imitation.model.torch_policy import StepInputs, StepOutputs, TorchPolicy

TEXT_ENCODER_FILE = "text_encoder.safetensors"
TEXTS_FILE = "goal_texts.json"
_ENCODER_KEY = "text_encoder"


class LanguagePolicy(TorchPolicy[LanguageNetwork]):
    """Follows a text, and says whether the goal is reached where its network does.

    Its recurrent state is then what the network said of the last observations, zeros at first. A goal counts as reached
    once it has seemed so in `reached_steps` of them in a row: what one frame shows, the robot may still carry on.

    A relation of two objects of its training texts that none of these states is followed, too, at an in-distribution
    score of 0.

    Args:
        network: Trained.
        text_encoder: The one that the network was trained with.
        control: Rate and limits.
        training_texts: The texts that it was fitted to.

    Raises:
        InvalidInput: The text encoder's embeddings are of another size than the network takes.
    """

    def __init__(
        self,
        network: LanguageNetwork,
        text_encoder: TextEncoder,
        control: ControlSpec,
        *,
        training_texts: Sequence[str],
    ) -> None:
        spec = network.spec
        if text_encoder.size != spec.text_size:
            raise InvalidInput(
                f"A policy's text encoder must have embeddings of {spec.text_size} numbers; got {text_encoder.size}.",
                hint="Fit the model again, or restore its folder from a copy.",
            )
        super().__init__(
            network,
            control,
            goal_form="text",
            training_texts=tuple(training_texts),
            objects=spec.phrases,
            unseen_objects=spec.unseen_objects and spec.eye is None,  # an object encoder has no place for others
            predicts_reached=spec.predicts_reached,
            recurrent_size=spec.reached_steps - 1 if spec.predicts_reached else 0,
        )
        self.spec.known_texts.read("")  # reads thousands of training texts here, and not on the event loop
        self._text_encoder = text_encoder
        self._reader = deepcopy(network.reader).cpu()

    @classmethod
    def load(cls, folder: Path, device: str) -> "LanguagePolicy":
        """Returns the policy in a folder; see `freerein.learning.methods.Method`.

        Raises:
            InvalidInput: A file is missing or malformed, or the text encoder's sha256 is not the card's.
        """
        card = model_files.read_card(folder)
        network = model_files.load_model(folder, LanguageSpec, LanguageNetwork, device=device)
        texts = _load_texts(folder, card)
        return cls(network, _load_text_encoder(folder, card), ControlSpec.from_card(card), training_texts=texts)

    def encode_goals(self, goals: Sequence[str]) -> npt.NDArray[np.float32]:
        """Returns the codes of texts, float32 (N, code size); each is independent of the others."""
        spec = self._network.spec
        encode = partial(
            encode_text,
            reader=self._reader,
            encoder=self._text_encoder,
            text_code=spec.text_code,
            phrases=spec.phrases,
        )
        return torch.stack([encode(goal) for goal in goals]).numpy()

    def _step(self, inputs: StepInputs) -> StepOutputs:
        network = self._network
        modulated = network.modulate(network.encoder(inputs.frames), inputs.goals)
        actions = network.act_on(modulated)
        chosen = actions.argmax(dim=2) if self.spec.action.choices else actions.clamp(-1, 1)  # (B, A)
        familiar = network.knows(inputs.goals).float()
        if network.recognizer is None:
            return StepOutputs(chosen[:, None], torch.zeros_like(familiar), inputs.recurrent, familiar)
        reached = network.recognizer(modulated)
        settled = (inputs.recurrent >= self.spec.reached_threshold).all(dim=1)
        seemed = torch.cat([inputs.recurrent, reached[:, None]], dim=1)  # (B, reached_steps)
        return StepOutputs(chosen[:, None], reached, seemed[:, 1:], familiar, settled)


def text_encoder_entry(name: str, data: bytes) -> dict[str, JSON]:
    """Returns the entry of a card that names a text encoder, for its name and file."""
    return {_ENCODER_KEY: {"name": name, "sha256": hashlib.sha256(data).hexdigest()}}


def _load_texts(folder: Path, card: dict[str, Any]) -> list[str]:
    """Returns the texts that a policy was fitted to; of one without the file of texts, those on its card."""
    try:
        path = folder / TEXTS_FILE
        texts = json.loads(path.read_bytes()) if path.exists() else card["goal_texts"]["first"]
    except (OSError, ValueError, RecursionError, KeyError, TypeError) as error:
        texts = error
    if not isinstance(texts, list) or not texts or not all(isinstance(text, str) for text in texts):
        raise InvalidInput(
            f"A language policy's folder must hold the goal texts that it was fitted to; got {type(texts).__name__}.",
            hint="Fit the model again, or restore its folder from a copy.",
        )
    return texts


def _load_text_encoder(folder: Path, card: dict[str, Any]) -> TextEncoder:
    try:
        data, expected = (folder / TEXT_ENCODER_FILE).read_bytes(), card[_ENCODER_KEY]["sha256"]
    except (OSError, KeyError, TypeError):
        data, expected = b"", None
    if (found := hashlib.sha256(data).hexdigest()) != expected:
        raise InvalidInput(
            f"The text encoder must have the sha256 on the card, {expected}; got {found}, of {len(data)} bytes.",
            hint="Fit the model again, or restore its folder from a copy.",
        )
    return TextEncoder(data)
