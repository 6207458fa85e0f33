"""The imitation service with a batch size of 1."""

from dataclasses import replace

from freerein.serving.health import Health
from freerein.serving.learned import LearnedSettings
from freerein.serving.lifecycle import Service, run
from freerein.serving.limits import Limits
from freerein.serving.metrics import Metrics
from freerein_imitation.__main__ import NAME, build


def build_unbatched(settings: LearnedSettings, limits: Limits, metrics: Metrics, health: Health) -> Service:
    """Returns the service."""
    return build(settings, replace(limits, batch=1), metrics, health)


if __name__ == "__main__":
    run(NAME, LearnedSettings, build_unbatched)
