"""The segmentation service with a planted leak, which the soak must find: it keeps 16 KiB of every call."""

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from freerein.serving.health import Health
from freerein.serving.learned import LearnedSettings
from freerein.serving.lifecycle import Service, run
from freerein.serving.limits import Limits
from freerein.serving.metrics import Metrics
from freerein_segmentation.__main__ import NAME, build
from freerein_segmentation.core import SkillModel
from freerein_segmentation.methods import METHODS
from freerein_segmentation.model import Prediction

LEAKED_BYTES = 16 * 2**10


def build_leaky(settings: LearnedSettings, limits: Limits, metrics: Metrics, health: Health) -> Service:
    """Returns the service."""

    def load(folder: Path, device: str) -> SkillModel:
        kept: list[bytearray] = []
        model = METHODS.load(folder, device)
        whole = model.predict

        def predict(frames: npt.NDArray[np.uint8], actions: npt.NDArray[Any] | None) -> Prediction:
            kept.append(bytearray(b"x" * LEAKED_BYTES))
            return whole(frames, actions)

        model.predict = predict  # type: ignore[method-assign]  # the leak
        return model

    return build(settings, limits, metrics, health, load=load)


if __name__ == "__main__":
    run(NAME, LearnedSettings, build_leaky)
