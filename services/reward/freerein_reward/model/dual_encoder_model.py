"""Inference with a trained dual encoder: numpy in, numpy out."""

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
import PIL.Image
import torch

from freerein_reward.goal_text import Grammar
from freerein_reward.model.dual_encoder import DualEncoder, channels_last

_IMAGES_AT_ONCE = 16
"""Their feature maps fit a core's cache; larger batches take longer per image."""


class DualEncoderModel:
    """Embeds images and texts with a trained network, on its own device; a `freerein_reward.core.RewardModel`."""

    def __init__(self, network: DualEncoder) -> None:
        self.network = channels_last(network.eval())
        self.cameras = network.spec.cameras
        self.grammar = Grammar(network.spec.phrases, network.spec.vocabulary)

    def preprocess(self, image: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
        """Returns an image uint8 (h, w, 1 or 3), of any size, as the network's input, uint8 (H, W, 3)."""
        return preprocess(image, size=self.network.spec.image_size)

    @torch.inference_mode()
    def embed_images(self, views: Mapping[str, npt.NDArray[np.uint8]]) -> npt.NDArray[np.float32]:
        """Returns embeddings, float32 (N, D), of frames by camera, uint8 (N, H, W, 3)."""
        stacked = np.stack([views[camera] for camera in self.cameras], axis=1)  # (N, V, H, W, 3)
        parts = torch.split(torch.from_numpy(stacked), _IMAGES_AT_ONCE)
        embeddings = torch.cat([self.network.embed_images(part.to(self.network.device)) for part in parts])
        array: npt.NDArray[np.float32] = embeddings.cpu().numpy()
        return array

    @torch.inference_mode()
    def embed_texts(self, texts: Sequence[str]) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_]]:
        """Returns embeddings, float32 (K, D), and whether each text was truncated, bool (K,)."""
        tokens = self.network.tokenizer(texts)
        embeddings = self.network.embed_texts(torch.from_numpy(tokens.ids).to(self.network.device))
        return embeddings.cpu().numpy(), tokens.truncated


def preprocess(image: npt.NDArray[np.uint8], *, size: int) -> npt.NDArray[np.uint8]:
    """Returns an image uint8 (h, w, 1 or 3) as RGB uint8 (size, size, 3), resized with antialiasing as in CLIP."""
    if image.shape[:2] != (size, size):
        pixels = PIL.Image.fromarray(image[:, :, 0] if image.shape[2] == 1 else image)
        image = np.asarray(pixels.resize((size, size), PIL.Image.Resampling.BICUBIC))
    return np.ascontiguousarray(np.broadcast_to(image.reshape(size, size, -1), (size, size, 3)))
