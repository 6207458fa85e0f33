"""The segmentation service with a planted leak, which the soak must find: it keeps 16 KiB of every call."""

from collections.abc import Sequence
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
from freerein_segmentation.core.inference import PredictionStream
from freerein_segmentation.methods import METHODS
from freerein_segmentation.model import Prediction

LEAKED_BYTES = 16 * 2**10


class LeakyModel:
    """A model that keeps something of every call.

    Args:
        model: What answers.
    """

    def __init__(self, model: SkillModel) -> None:
        self._model = model
        self.skills, self.camera, self.action, self.lag = model.skills, model.camera, model.action, model.lag
        self.fps = model.fps
        self._kept: list[bytearray] = []

    def predict(self, frames: npt.NDArray[np.uint8], actions: npt.NDArray[Any] | None) -> Prediction:
        """Returns the model's answer."""
        self._kept.append(bytearray(b"x" * LEAKED_BYTES))
        return self._model.predict(frames, actions)

    def encode(self, frames: npt.NDArray[np.uint8], actions: npt.NDArray[Any] | None) -> Any:
        """Returns the model's encoding."""
        return self._model.encode(frames, actions)

    def predict_encoded(self, parts: Sequence[Any]) -> Prediction:
        """Returns the model's answer."""
        return self._model.predict_encoded(parts)

    def stream(self) -> PredictionStream:
        """Returns the model's stream, which leaks nothing."""
        return self._model.stream()


def build_leaky(settings: LearnedSettings, limits: Limits, metrics: Metrics, health: Health) -> Service:
    """Returns the service."""

    def load(folder: Path, device: str) -> SkillModel:
        return LeakyModel(METHODS.load(folder, device))

    return build(settings, limits, metrics, health, load=load)


if __name__ == "__main__":
    run(NAME, LearnedSettings, build_leaky)
