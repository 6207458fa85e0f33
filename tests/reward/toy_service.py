"""The reward service as it is, around the contract suite's models: a process that is there at once."""

import json
import sys
from pathlib import Path

from freerein.model_store import ModelStore
from freerein.serving.health import Health
from freerein.serving.lifecycle import Service, run
from freerein.serving.limits import Limits
from freerein.serving.metrics import Metrics
from freerein_reward.__main__ import NAME, build
from freerein_reward.settings import RewardSettings

sys.path.insert(0, str(Path(__file__).parents[1] / "contract"))


def build_toy(settings: RewardSettings, limits: Limits, metrics: Metrics, health: Health) -> Service:
    """Returns the service."""
    from reward_cases import load

    for name in ("default", "grounding"):
        store, folder = ModelStore(settings.data_dir / "models" / NAME), settings.data_dir / f"unpublished-{NAME}"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "card.json").write_text(json.dumps({"dataset": "none"}))
        store.activate(store.publish(name, folder))
    return build(settings, limits, metrics, health, load=load)


if __name__ == "__main__":
    run(NAME, RewardSettings, build_toy)
