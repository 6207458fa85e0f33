"""Loading of trained dual encoders."""

from pathlib import Path

from freerein.errors import InvalidInput
from freerein.learning import model_files
from freerein_reward.model.dual_encoder import DualEncoder
from freerein_reward.model.dual_encoder_model import DualEncoderModel
from freerein_reward.model.grounding import GradCamModel
from freerein_reward.model.imported_grounding import ImportedGrounding, load_imported
from freerein_reward.model.spec import DualEncoderSpec

GROUNDING = "grounding"
"""Name of the grounding model, and the `method` of its card."""


def load_reward_model(folder: Path, device: str) -> DualEncoderModel:
    """Returns the reward model in a folder; raises as `freerein.learning.model_files.load_model`."""
    return DualEncoderModel(_load_network(folder, device))


def load_grounding(folder: Path, device: str) -> GradCamModel | ImportedGrounding:
    """Returns the grounding model in a folder, the built-in one or another.

    Raises as `load_reward_model` and `load_imported`, and InvalidInput for a reward model.
    """
    card = model_files.read_card(folder)
    if card.get("method") != GROUNDING:
        raise InvalidInput(
            "Captions need a grounding model; got another one.",
            hint="Activate another version of the model `grounding`, and restart the service.",
        )
    return load_imported(folder, card, device) if "layout" in card else GradCamModel(_load_network(folder, device))


def load_built_in(folder: Path, device: str) -> GradCamModel:
    """Returns the grounding model in a folder. Raises as `load_grounding`, and InvalidInput unless it is built in."""
    if isinstance(model := load_grounding(folder, device), GradCamModel):
        return model
    raise InvalidInput(
        "This fit begins with the weights of the built-in grounding model; the active one was trained elsewhere.",
        hint="Use the method relation_captions with initial=scratch and distillation=10, or activate the built-in "
        "version of `grounding` and restart the service.",
    )


def is_grounding(folder: Path) -> bool:
    """Returns whether a folder holds a grounding model, by its card; raises as `model_files.read_card`."""
    return model_files.read_card(folder).get("method") == GROUNDING


def _load_network(folder: Path, device: str) -> DualEncoder:
    return model_files.load_model(folder, DualEncoderSpec, DualEncoder, device=device)
