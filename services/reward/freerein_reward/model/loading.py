"""Loading of trained dual encoders; a card's `kind` is `reward` or `grounding`."""

from pathlib import Path

from freerein.errors import InvalidInput
from freerein.learning import model_files
from freerein_reward.model.dual_encoder import DualEncoder
from freerein_reward.model.dual_encoder_model import DualEncoderModel
from freerein_reward.model.grounding import GradCamModel
from freerein_reward.model.spec import DualEncoderSpec

GROUNDING, REWARD = "grounding", "reward"


def load(folder: Path, device: str) -> DualEncoderModel:
    """Returns the model in a folder; a `GradCamModel` when its kind is `grounding`.

    Raises InvalidInput when the card names another kind; otherwise as `freerein.learning.model_files.load_model`.
    """
    kind = model_files.read_card(folder).get("kind")
    if kind not in (GROUNDING, REWARD):
        raise InvalidInput(
            f"The card's `kind` must be {GROUNDING} or {REWARD}; it is not.",
            hint="Fit the model again, or restore its folder from a copy.",
        )
    network = model_files.load_model(folder, DualEncoderSpec, DualEncoder, device=device)
    return GradCamModel(network) if kind == GROUNDING else DualEncoderModel(network)


def load_grounding(folder: Path, device: str) -> GradCamModel:
    """Returns the grounding model in a folder. Raises as `load`, and InvalidInput for a reward model."""
    model = load(folder, device)
    if not isinstance(model, GradCamModel):
        raise InvalidInput("Captions need a grounding model; got a reward model.", field="grounding")
    return model
