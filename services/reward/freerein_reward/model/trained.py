"""Trained dual encoders as folders on disk.

A card's `kind` says what a folder holds: `reward` or `grounding`.
"""

from pathlib import Path

from freerein.errors import InvalidInput
from freerein.learning import model_files
from freerein_reward.model.dual_encoder import DualEncoder, DualEncoderSpec
from freerein_reward.model.grounding import GroundingModel
from freerein_reward.model.preprocess import Preprocess
from freerein_reward.model.similarity import RewardModel

GROUNDING, REWARD = "grounding", "reward"


def load(folder: Path, device: str) -> tuple[RewardModel | GroundingModel, Preprocess]:
    """Returns the model in a folder, and what makes any image into what it sees.

    Args:
        folder: Written by `freerein.learning.model_files.export`; read as untrusted.
        device: `auto`, `cpu` or `cuda:N`.

    Raises:
        InvalidInput: A file is missing, or is not what `export` writes, or the card names another kind.
    """
    kind = model_files.read_card(folder).get("kind")
    if kind not in (GROUNDING, REWARD):
        raise InvalidInput(
            f"The card of a model of the reward service must name its kind, {GROUNDING} or {REWARD}; it does not.",
            hint="Fit the model again, or restore its folder from a copy.",
        )
    network = model_files.load_model(folder, DualEncoderSpec, DualEncoder, device=device)
    model = GroundingModel(network) if kind == GROUNDING else RewardModel(network)
    return model, Preprocess(network.spec.side)


def load_grounding(folder: Path, device: str) -> GroundingModel:
    """Returns the grounding model in a folder.

    Raises:
        InvalidInput: As `load`, or it is a reward model.
    """
    model, _ = load(folder, device)
    if not isinstance(model, GroundingModel):
        raise InvalidInput("Captions must be told by a grounding model; got a reward model.", field="grounding")
    return model
