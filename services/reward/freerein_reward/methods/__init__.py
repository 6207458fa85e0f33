"""The service's methods: ways to make a reward model from images and noun phrases.

The grounding model is fitted to no dataset: `freerein_reward.pretrain` trains it, `freerein_reward.import_model` takes
one that was trained elsewhere, and `load` loads both.
"""

from pathlib import Path
from types import MappingProxyType

from freerein.learning.methods import Methods
from freerein_reward.methods import criterion_captions, relation_captions
from freerein_reward.methods.criterion_captions.criterion_model import CriterionModel
from freerein_reward.model import DualEncoderModel, ImportedGrounding, is_grounding, load_grounding

METHODS: Methods[DualEncoderModel | CriterionModel] = Methods(
    "reward",
    MappingProxyType({"relation_captions": relation_captions.METHOD, "criterion_captions": criterion_captions.METHOD}),
)


def load(folder: Path, device: str) -> DualEncoderModel | CriterionModel | ImportedGrounding:
    """Returns the model in a folder, by the method that its card names: the grounding model, or one that was fitted.

    Raises:
        InvalidInput: A file is missing or malformed.
    """
    return load_grounding(folder, device) if is_grounding(folder) else METHODS.load(folder, device)
