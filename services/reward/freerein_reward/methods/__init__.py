"""The service's methods: ways to make a reward model from images and noun phrases.

The grounding model is fitted to no dataset: `freerein_reward.pretrain` trains it, and `load` loads it too.
"""

from pathlib import Path
from types import MappingProxyType

from freerein.learning.methods import Methods
from freerein_reward.methods import relation_captions
from freerein_reward.model import DualEncoderModel, is_grounding, load_grounding

METHODS: Methods[DualEncoderModel] = Methods(
    "reward", MappingProxyType({"relation_captions": relation_captions.METHOD})
)


def load(folder: Path, device: str) -> DualEncoderModel:
    """Returns the model in a folder, by the method that its card names: the grounding model, or one that was fitted.

    Raises:
        InvalidInput: A file is missing or malformed.
    """
    return load_grounding(folder, device) if is_grounding(folder) else METHODS.load(folder, device)
