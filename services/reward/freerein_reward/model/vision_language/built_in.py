"""The built-in dual encoder as a vision-language model."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freerein_reward.model.dual_encoder import DualEncoder
from freerein_reward.model.dual_encoder_model import preprocess
from freerein_reward.model.vision_language.interface import TracedMaps


class BuiltIn:
    """A dual encoder that pools by attention; see `VisionLanguageModel`."""

    def __init__(self, network: DualEncoder) -> None:
        self._network = network
        self.image_size = network.spec.image_size
        self.dimension = network.spec.embedding_dim

    @property
    def device(self) -> torch.device:
        """Device of the weights."""
        return self._network.device

    def preprocess(self, image: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
        """Returns an image uint8 (h, w, 1 or 3), of any size, as the model's, uint8 (H, W, 3)."""
        return preprocess(image, size=self.image_size)

    def embed_images(self, images: Tensor) -> Tensor:
        """Returns the embeddings, float32 (N, D) of length 1, of images uint8 (N, H, W, 3)."""
        return self._network.embed_images(images[:, None])

    def embed_texts(self, texts: Sequence[str]) -> Tensor:
        """Returns the embeddings, float32 (K, D) of length 1, of texts."""
        return self._network.embed_texts(self._network.tokenize(texts))

    def truncated(self, texts: Sequence[str]) -> npt.NDArray[np.bool_]:
        """Returns whether each text is longer than the model reads, bool (K,)."""
        return self._network.tokenizer(texts).truncated

    def last_maps(self, images: Tensor) -> Tensor:
        """Returns the last convolution's output, float32 (N, C, h, w), of images uint8 (N, H, W, 3)."""
        return self._network.image.feature_maps(images)

    def traced_maps(self, images: Tensor) -> TracedMaps:
        """Returns these maps, and the embeddings as a function of them, with attention and length held fixed."""
        maps = self.last_maps(images).detach().requires_grad_()
        embeddings = self._network.image.attention_pool(maps, fixed_attention=True)
        return TracedMaps(maps, embeddings / embeddings.detach().norm(dim=1, keepdim=True))

    def channel_weights(self, directions: Tensor) -> Tensor:
        """Returns Grad-CAM's channel weights, but for a factor: float32 (P, C) of directions (P, D)."""
        pool = self._network.image.attention_pool
        weights: Tensor = directions @ pool.out.weight @ pool.value.weight
        return weights
