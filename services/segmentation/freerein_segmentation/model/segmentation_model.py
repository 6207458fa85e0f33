"""Inference with a trained segmentation network: numpy in, numpy out."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from freerein.errors import FailedPrecondition, must_be, quoted
from freerein.learning import model_files
from freerein.learning.action_scaling import UnscaledActionSpec
from freerein_segmentation.model.network import ModelSpec, SegmentationNetwork
from freerein_segmentation.model.stream import FRAMES_AT_ONCE, Prediction, SegmentationStream


@dataclass(frozen=True, eq=False)
class Encoded:
    """Timesteps as the recurrent layers see them.

    Attributes:
        features: float32 (n, D).
        distances: float32 (n,), how far frames are from those of the fit.
    """

    features: torch.Tensor
    distances: torch.Tensor


class SegmentationModel:
    """Runs a trained network on its own device; see `freerein_segmentation.core.SkillModel` for the other attributes.

    Attributes:
        lag: Timesteps after a timestep that its prediction depends on; None for a model of whole trajectories.
        fps: Timesteps per second of what it was trained on; 0 where unknown.
    """

    def __init__(self, network: SegmentationNetwork, *, fps: float = 0.0) -> None:
        spec = network.spec
        self.skills = spec.skills
        (self.camera,) = spec.cameras
        taken = UnscaledActionSpec(**vars(spec.action)) if spec.action_scaling else spec.action
        self.action = taken if spec.use_actions else None
        self.lag = spec.context * spec.stride if isinstance(spec.context, int) else None
        self.fps = fps
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
            seen, did = frames[at], actions[at]
            windows = [slice(start, start + FRAMES_AT_ONCE) for start in range(0, len(seen), FRAMES_AT_ONCE)]
            parts = [self._features(seen[window], did[window]) for window in windows]
            features, distances = (torch.cat(each) for each in zip(*parts, strict=True))  # (T, D), (T,)
            probabilities[at], in_distribution[at] = self._scored(features, distances)
        return Prediction(probabilities, in_distribution)

    @torch.inference_mode()
    def encode(self, frames: npt.NDArray[np.uint8], actions: npt.NDArray[Any] | None) -> Encoded:
        """Returns some of a trajectory's timesteps as the recurrent layers see them."""
        if actions is None:
            actions = np.zeros((len(frames), 0), np.float32)
        return Encoded(*self._features(frames, actions))

    @torch.inference_mode()
    def predict_encoded(self, parts: Sequence[Encoded]) -> Prediction:
        """Returns the prediction for a trajectory whose frames need not be in memory, in parts."""
        features = torch.cat([part.features for part in parts])
        distances = torch.cat([part.distances for part in parts])
        probabilities = np.empty((len(features), len(self.skills)), np.float32)
        in_distribution = np.empty(len(features), np.float32)
        for phase in range(min(self._stride, len(features))):
            at = slice(phase, None, self._stride)
            probabilities[at], in_distribution[at] = self._scored(features[at], distances[at])
        return Prediction(probabilities, in_distribution)

    def stream(self) -> SegmentationStream:
        """Returns a stream of predictions for one trajectory.

        Raises:
            FailedPrecondition: The model sees whole trajectories.
        """
        context = self._network.spec.context
        if not isinstance(context, int):
            raise FailedPrecondition(
                "A stream needs a model that sees a number of future timesteps; this one sees whole trajectories.",
                hint="Fit one with --set context=10, or send the whole trajectory.",
            )
        return SegmentationStream(self._network, self._features, context=context)

    def _scored(
        self, features: torch.Tensor, distances: torch.Tensor
    ) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
        """Returns probabilities and scores of features (T, D) and distances (T,), one stride apart, as in training."""
        probabilities = self._network.score(features).softmax(dim=1)  # (T, K)
        scores = self._network.in_distribution(distances, probabilities.amax(dim=1))
        return probabilities.cpu().numpy(), scores.cpu().numpy()

    def _features(self, frames: npt.NDArray[np.uint8], actions: npt.NDArray[Any]) -> tuple[torch.Tensor, torch.Tensor]:
        """Returns the LSTM's inputs, and how far frames are from those of the fit.

        It copies the arrays, because those from the wire are read-only.
        """
        images = {self.camera.name: torch.tensor(frames, device=self._device)}
        distances = self._network.in_distribution.distance(self._network.statistics(images))
        return self._network.features(images, torch.tensor(actions, device=self._device)), distances


def load(folder: Path, device: str) -> SegmentationModel:
    """Returns the model in a folder; see `freerein.learning.model_files.load_model`."""
    network = model_files.load_model(folder, ModelSpec, SegmentationNetwork, device=device)
    return SegmentationModel(network, fps=_fps(model_files.read_card(folder)))


def _fps(card: Mapping[str, Any]) -> float:
    """Returns the timesteps per second that a card names; 0 for an earlier card, which names none."""
    data = card.get("data")
    fps = data.get("fps", 0.0) if isinstance(data, Mapping) else 0.0
    if isinstance(fps, bool) or not isinstance(fps, int | float) or not 0.0 <= fps < math.inf:
        rule, hint = "a number of timesteps per second", "Fit the model again, or restore its folder from a copy."
        raise must_be("`data.fps` of a model's card", rule, quoted(str(fps)), field="", hint=hint)
    return float(fps)
