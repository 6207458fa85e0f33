"""Inference with a trained segmentation network: numpy in, numpy out."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from freerein.learning import model_files
from freerein.learning.image_statistics import image_statistics
from freerein_segmentation.model.network import ModelSpec, SegmentationNetwork

_FRAMES_AT_ONCE = 256


@dataclass(frozen=True, eq=False)
class Prediction:
    """What a model says of T timesteps.

    Attributes:
        probabilities: P(y_t = k), eq. 2.1, float32 (T, K).
        in_distribution: How much each is like those on held-out data, float32 (T,) in [0, 1]; see
            `freerein.learning.in_distribution`.
    """

    probabilities: npt.NDArray[np.float32]
    in_distribution: npt.NDArray[np.float32]


class SegmentationModel:
    """Runs a trained network on its own device; see `freerein_segmentation.core.SkillModel` for the attributes."""

    def __init__(self, network: SegmentationNetwork) -> None:
        spec = network.spec
        self.skills = spec.skills
        (self.camera,) = spec.cameras
        self.action = spec.action if spec.use_actions else None
        self._stride = spec.stride
        self._network = network.eval()
        self._device = next(network.parameters()).device

    @torch.inference_mode()
    def predict(self, frames: npt.NDArray[np.uint8], actions: npt.NDArray[Any] | None) -> Prediction:
        """Returns the prediction for a trajectory, in bounded working memory; see `SkillModel`."""
        if actions is None:
            actions = np.zeros((len(frames), 0), np.float32)
        probabilities = np.empty((len(frames), len(self.skills)), np.float32)
        in_distribution = np.empty(len(frames), np.float32)
        for phase in range(min(self._stride, len(frames))):
            at = slice(phase, None, self._stride)
            probabilities[at], in_distribution[at] = self._strided(frames[at], actions[at])
        return Prediction(probabilities, in_distribution)

    def _strided(
        self, frames: npt.NDArray[np.uint8], actions: npt.NDArray[Any]
    ) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
        """Returns probabilities and scores of timesteps that are one stride apart, as in training."""
        windows = [slice(start, start + _FRAMES_AT_ONCE) for start in range(0, len(frames), _FRAMES_AT_ONCE)]
        parts = [self._features(frames[at], actions[at]) for at in windows]
        features, distances = (torch.cat(each) for each in zip(*parts, strict=True))  # (T, D), (T,)
        probabilities = self._network.score(features).softmax(dim=1)  # (T, K)
        scores = self._network.in_distribution(distances, probabilities.amax(dim=1))
        return probabilities.cpu().numpy(), scores.cpu().numpy()

    def _features(self, frames: npt.NDArray[np.uint8], actions: npt.NDArray[Any]) -> tuple[torch.Tensor, torch.Tensor]:
        """Returns the LSTM's inputs, and how far frames are from those of the fit.

        It copies the arrays, because those from the wire are read-only.
        """
        images = {self.camera.name: torch.tensor(frames, device=self._device)}
        distances = self._network.in_distribution.distance(image_statistics(images))
        return self._network.features(images, torch.tensor(actions, device=self._device)), distances


def load(folder: Path, device: str) -> SegmentationModel:
    """Returns the model in a folder; see `freerein.learning.model_files.load_model`."""
    return SegmentationModel(model_files.load_model(folder, ModelSpec, SegmentationNetwork, device=device))
