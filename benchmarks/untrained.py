"""Untrained models, initialised and published: training does not change the time of a call."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import nn

from freerein.learning import weights
from freerein.learning.model_files import save_model
from freerein.model_store import ModelStore
from freerein.types.common import ModelRef
from freerein_reward.model import DualEncoderSpec
from freerein_reward.training import synthetic_objects
from freerein_reward.training.config import GroundingConfig


def grounding_spec() -> DualEncoderSpec:
    """Returns the grounding model of a pre-training's default size."""
    tower = GroundingConfig()
    return DualEncoderSpec(
        cameras=("",),
        vocabulary=synthetic_objects.VOCABULARY,
        image_size=synthetic_objects.IMAGE_SIZE,
        width=tower.width,
        depth=tower.depth,
    )


def initialise(network: nn.Module) -> None:
    """Draws the weights of a network."""
    weights.initialise(network, generator=torch.Generator().manual_seed(0))


def publish(network: nn.Module, data_dir: Path, service: str, *, name: str, card: Mapping[str, Any]) -> ModelRef:
    """Saves a network as the active model of a service."""
    folder = data_dir / "unpublished"
    folder.mkdir(parents=True)
    save_model(network, folder, card=dict(card))
    store = ModelStore(data_dir / "models" / service)
    ref = store.publish(name, folder)
    store.activate(ref)
    return ref
