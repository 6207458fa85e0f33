"""A trained network as the service knows it: numpy in, numpy out, and a folder on disk."""

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from freerein.learning import model_files
from freerein_segmentation.model.network import ModelSpec, SegmentationNetwork

_FRAMES_AT_ONCE = 256


class SegmentationModel:
    """Labels trajectories. The network's device is where it computes; arrays are on the CPU.

    Args:
        network: Trained.

    Attributes:
        skills: What it labels.
        camera: Which camera's frames it was trained on.
        height: Of the frames, in pixels.
        width: In pixels.
        channels: 1 or 3.
        action_size: Numbers per action; 0 without actions.
        action_choices: How many different actions there are when discrete, else 0.
    """

    def __init__(self, network: SegmentationNetwork) -> None:
        spec = network.spec
        self.skills = spec.skills
        self.camera = spec.camera
        self.height, self.width, self.channels = spec.height, spec.width, spec.channels
        self.action_size, self.action_choices = spec.action_size, spec.action_choices
        self._stride = spec.stride
        self._network = network.eval()
        self._device = next(network.parameters()).device

    @torch.inference_mode()
    def probabilities(self, frames: npt.NDArray[np.uint8], actions: npt.NDArray[Any] | None) -> npt.NDArray[np.float32]:
        """Returns P(y_t = k), eq. 2.1: float32 (T, K), in memory that hardly grows with T.

        Args:
            frames: uint8 (T, H, W, C), T at least 1.
            actions: float32 (T, A) or int64 (T, 1); not looked at by a model without actions.
        """
        done = np.zeros((len(frames), 0), np.float32) if actions is None else actions
        probabilities = np.empty((len(frames), len(self.skills)), np.float32)
        for phase in range(min(self._stride, len(frames))):
            probabilities[phase :: self._stride] = self._pass(
                frames[phase :: self._stride], done[phase :: self._stride]
            )
        return probabilities

    def _pass(self, frames: npt.NDArray[np.uint8], actions: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
        """Returns the probabilities of timesteps as far apart as they were in training."""
        windows = [slice(start, start + _FRAMES_AT_ONCE) for start in range(0, len(frames), _FRAMES_AT_ONCE)]
        features = torch.cat([self._network.features(*self._load(frames[at], actions[at])) for at in windows])  # (T, D)
        probabilities: npt.NDArray[np.float32] = self._network.score(features).softmax(dim=1).cpu().numpy()
        return probabilities

    def _load(self, *arrays: npt.NDArray[Any]) -> tuple[torch.Tensor, ...]:
        """Returns copies on the network's device: arrays that came over a wire cannot be written to."""
        return tuple(torch.tensor(array, device=self._device) for array in arrays)


def load(folder: Path, device: str) -> SegmentationModel:
    """Returns the model in a folder.

    Args:
        folder: Written by `freerein.learning.model_files.export`; read as untrusted.
        device: `auto`, `cpu` or `cuda:N`.

    Raises:
        InvalidInput: A file is missing, or is not what `export` writes.
    """
    return SegmentationModel(model_files.load_model(folder, ModelSpec, SegmentationNetwork, device=device))
