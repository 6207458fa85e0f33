"""Inference with a trained dual encoder: numpy in, numpy out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import PIL.Image
import torch

from freerein.goal_text import NEARBY_WORDS, Grammar
from freerein_reward.model.dual_encoder import DualEncoder, channels_last

_IMAGES_AT_ONCE = 16
"""Their feature maps fit a core's cache; larger batches take longer per image."""


@dataclass(frozen=True, eq=False)
class ImageEmbeddings:
    """Embeddings of N moments.

    Attributes:
        vectors: Embeddings, float32 (N, D).
        distances: How far the images are from those of the fit, float32 (N,); 0 for a grounding model.
    """

    vectors: npt.NDArray[np.float32]
    distances: npt.NDArray[np.float32]


class DualEncoderModel:
    """Embeds images and texts with a trained network, on its own device; a `freerein_reward.core.RewardModel`."""

    def __init__(self, network: DualEncoder) -> None:
        self.network = channels_last(network.eval())
        self.cameras = network.spec.cameras
        self.aspects: Mapping[str, float] = dict(
            zip(self.cameras, network.spec.aspects, strict=False)
        )  # without aspects, any frames
        self.grammar = Grammar(network.spec.phrases, network.spec.vocabulary, untold=NEARBY_WORDS)

    def preprocess(self, image: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
        """Returns an image uint8 (h, w, 1 or 3), of any size, as the network's input, uint8 (H, W, 3)."""
        return preprocess(image, size=self.network.spec.image_size)

    @torch.inference_mode()
    def embed_images(self, views: Mapping[str, npt.NDArray[np.uint8]]) -> ImageEmbeddings:
        """Returns what a model keeps of frames by camera, uint8 (N, H, W, 3)."""
        stacked = np.stack([views[camera] for camera in self.cameras], axis=1)  # (N, V, H, W, 3)
        parts = torch.split(torch.from_numpy(stacked), _IMAGES_AT_ONCE)
        seen = [part.to(self.network.device) for part in parts]
        vectors = torch.cat(list(map(self.network.embed_images, seen)))
        distances = torch.cat(list(map(self.network.distance, seen)))
        return ImageEmbeddings(vectors.cpu().numpy(), distances.cpu().numpy())

    @torch.inference_mode()
    def in_distribution(
        self, distances: npt.NDArray[np.float32], similarities: npt.NDArray[np.float32]
    ) -> npt.NDArray[np.float32]:
        """Returns how much each answer is like held-out ones, float32 (N,), or (0,) for a grounding model.

        `distances` are those of `ImageEmbeddings`, (N,); `similarities` those of the K texts that rival, (N, K).
        """
        score = self.network.in_distribution
        if score is None:
            return np.empty(0, np.float32)
        scores = self.network.temperature(torch.from_numpy(similarities).to(self.network.device))
        distance = torch.from_numpy(distances).to(self.network.device)
        found: npt.NDArray[np.float32] = score(distance, scores.softmax(dim=1).amax(dim=1)).cpu().numpy()
        return found

    @torch.inference_mode()
    def embed_texts(self, texts: Sequence[str]) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_]]:
        """Returns embeddings, float32 (K, D), and whether each text was truncated, bool (K,)."""
        tokens = self.network.tokenizer(texts)
        embeddings = self.network.embed_texts(torch.from_numpy(tokens.ids).to(self.network.device))
        return embeddings.cpu().numpy(), tokens.truncated

    def similarities(self, images: npt.NDArray[np.float32], texts: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Returns the products of embeddings of images (N, D) and texts (K, D), float32 (N, K) in [-1, 1]."""
        return (images @ texts.T).clip(-1.0, 1.0)


def preprocess(image: npt.NDArray[np.uint8], *, size: int) -> npt.NDArray[np.uint8]:
    """Returns an image uint8 (h, w, 1 or 3) as RGB uint8 (size, size, 3), resized with antialiasing as in CLIP."""
    if image.shape[:2] != (size, size):
        pixels = PIL.Image.fromarray(image[:, :, 0] if image.shape[2] == 1 else image)
        image = np.asarray(pixels.resize((size, size), PIL.Image.Resampling.BICUBIC))
    return np.ascontiguousarray(np.broadcast_to(image.reshape(size, size, -1), (size, size, 3)))
