"""The reward service as it is, around a network that was never trained and the grounding model that is shipped.

What the fault tests ask of it must hold for any weights, and these are there at once.
"""

import shutil

import torch

from freerein.learning import weights
from freerein.learning.exports import export
from freerein.serving.health import Health
from freerein.serving.lifecycle import Service, run
from freerein.serving.limits import Limits
from freerein.serving.metrics import Metrics
from freerein.serving.models import ModelStore
from freerein_reward.__main__ import NAME, build
from freerein_reward.model import REWARD, DualEncoder, DualEncoderSpec
from freerein_reward.settings import RewardSettings

WORDS = ("a", "red", "yellow", "block", "on", "top", "of")


def build_untrained(settings: RewardSettings, limits: Limits, metrics: Metrics, health: Health) -> Service:
    """Returns the service."""
    store, folder = ModelStore(settings.data_dir / "models" / NAME), settings.data_dir / "unpublished"
    if not store.active_version("default"):
        shutil.rmtree(folder, ignore_errors=True)
        network = DualEncoder(DualEncoderSpec(cameras=("front",), vocabulary=WORDS, heads=8, hidden=64))
        weights.draw(network, generator=torch.Generator().manual_seed(0))
        export(network, folder, card={"kind": REWARD})
        store.activate(store.publish("", folder))
    return build(settings, limits, metrics, health)


if __name__ == "__main__":
    raise SystemExit(run(NAME, RewardSettings, build_untrained))
