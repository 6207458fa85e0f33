"""A trained dual encoder as what makes images and texts comparable: numpy in, numpy out."""

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
import torch

from freerein_reward.model.dual_encoder import DualEncoder, channels_last

_IMAGES_AT_ONCE = 16
"""What a core's cache holds the maps of: more at once take longer each."""


class RewardModel:
    """Makes images and texts comparable. The network's device is where it computes; arrays are on the CPU.

    Args:
        network: Trained.

    Attributes:
        cameras: Whose frames it sees.
    """

    def __init__(self, network: DualEncoder) -> None:
        self.cameras = network.spec.cameras
        self._network = channels_last(network.eval())
        self._device = network.temperature.log_scale.device

    @torch.inference_mode()
    def embed_images(self, views: Mapping[str, npt.NDArray[np.uint8]]) -> npt.NDArray[np.float32]:
        """Returns the embeddings, float32 (N, D), of length 1, of frames by camera, uint8 (N, H, W, 3)."""
        stacked = np.stack([views[camera] for camera in self.cameras], axis=1)  # (N, V, H, W, 3)
        parts = torch.split(torch.from_numpy(stacked), _IMAGES_AT_ONCE)
        embeddings = torch.cat([self._network.embed_images(part.to(self._device)) for part in parts])
        found: npt.NDArray[np.float32] = embeddings.cpu().numpy()
        return found

    @torch.inference_mode()
    def embed_texts(self, texts: Sequence[str]) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_]]:
        """Returns the embeddings, float32 (K, D), of length 1, and whether each text was cut, bool (K,)."""
        tokens = self._network.tokenizer(texts)
        embeddings = self._network.embed_texts(torch.from_numpy(tokens.ids).to(self._device))
        return embeddings.cpu().numpy(), tokens.truncated

    def unknown_words(self, text: str) -> int:
        """Returns how many words of a text it has never seen."""
        return int(self._network.tokenizer([text]).unknown[0])
