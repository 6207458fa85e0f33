"""A CLIP-style dual encoder: an image encoder and a text encoder, compared by cosine similarity."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from freerein.errors import InvalidInput
from freerein.learning.config import bounded
from freerein_reward.model.image_encoder import DOWNSAMPLING, ClipImageEncoder
from freerein_reward.model.text_encoder import ClipTextEncoder
from freerein_reward.model.tokenizer import Tokenizer

_INITIAL_SCALE, _MAX_SCALE = 1 / 0.07, 100.0
_MULTIPLE = 16


@dataclass(frozen=True, kw_only=True)
class DualEncoderSpec:
    """Architecture of a dual encoder.

    Attributes:
        cameras: Camera names; the image embedding is the mean over cameras. One empty name for any image.
        vocabulary: Words of the training texts.
        image_size: Height and width of the image encoder's input, in pixels; a multiple of 4.
        width: Channels of the image encoder's stem; a multiple of 8.
        depth: Bottlenecks per stage of the image encoder.
        keypoints: Keypoints of the image encoder's pooling, for relations; 0 for attention pooling, for nouns.
        hidden: Units of each hidden layer after keypoint pooling.
        text_width: Channels of the text encoder; a multiple of 16.
        text_depth: Layers of the text encoder.
        embedding_dim: Dimension of the embeddings.
        presence_heat: Grad-CAM peak at which an object is present with probability 1/2; of a grounding model.

    Raises:
        InvalidInput: There are no cameras or no words, or a size is not a multiple.
    """

    cameras: tuple[str, ...]
    vocabulary: tuple[str, ...]
    image_size: int = bounded(64, least=16, most=512)
    width: int = bounded(8, least=8, most=128)
    depth: int = bounded(1, least=1, most=8)
    keypoints: int = bounded(0, least=0, most=512)
    hidden: int = bounded(256, least=1, most=4096)
    text_width: int = bounded(64, least=16, most=1024)
    text_depth: int = bounded(2, least=1, most=12)
    embedding_dim: int = bounded(64, least=8, most=1024)
    presence_heat: float = bounded(1.0, least=1e-6, most=1e6)

    def __post_init__(self) -> None:
        is_uneven = self.image_size % DOWNSAMPLING or self.width % 8 or self.text_width % _MULTIPLE
        if not self.cameras or not self.vocabulary or is_uneven:
            raise InvalidInput(
                "A dual encoder needs a camera, a vocabulary, an `image_size` that is a multiple of 4, a `width` of 8 "
                f"and a `text_width` of 16; got {len(self.cameras)} cameras, {len(self.vocabulary)} words, "
                f"{self.image_size}, {self.width} and {self.text_width}.",
                hint="Leave sizes out for the defaults.",
            )


class DualEncoder(nn.Module):
    """A small CLIP."""

    def __init__(self, spec: DualEncoderSpec) -> None:
        super().__init__()
        self.spec = spec
        self.tokenizer = Tokenizer(spec.vocabulary)
        self.image = ClipImageEncoder(
            width=spec.width,
            depth=spec.depth,
            keypoints=spec.keypoints,
            hidden=spec.hidden,
            embedding_dim=spec.embedding_dim,
        )
        self.text = ClipTextEncoder(
            tokens=self.tokenizer.size,
            width=spec.text_width,
            depth=spec.text_depth,
            embedding_dim=spec.embedding_dim,
        )
        self.temperature = Temperature()

    def embed_images(self, views: Tensor) -> Tensor:
        """Returns unit embeddings, float32 (N, D), of V camera views, uint8 (N, V, image_size, image_size, 3)."""
        embeddings = self.image(views.flatten(end_dim=1)).unflatten(0, views.shape[:2])  # (N, V, D)
        return functional.normalize(embeddings.mean(dim=1), dim=1)

    def embed_texts(self, ids: Tensor) -> Tensor:
        """Returns unit embeddings, float32 (K, D), of tokens int64 (K, L)."""
        return functional.normalize(self.text(ids), dim=1)

    def tokenize(self, texts: Sequence[str]) -> Tensor:
        """Returns the tokens of texts, int64 (K, L), on the network's device."""
        return torch.from_numpy(self.tokenizer(texts).ids).to(self.device)

    @property
    def device(self) -> torch.device:
        """Device of the parameters."""
        return self.temperature.log_scale.device


def channels_last(network: DualEncoder) -> DualEncoder:
    """Returns the network itself in channels-last memory format, which halves its time on a CPU."""
    return network.to(memory_format=torch.channels_last)  # type: ignore[call-overload, no-any-return]  # torch's stub


class Temperature(nn.Module):
    """CLIP's learned inverse temperature of cosine similarities, at most 100."""

    def __init__(self) -> None:
        super().__init__()
        self.log_scale = nn.Parameter(torch.empty(()))

    def initialise(self, generator: torch.Generator) -> None:
        """Sets the initial value, which is not random."""
        nn.init.constant_(self.log_scale, math.log(_INITIAL_SCALE))

    def forward(self, cosines: Tensor) -> Tensor:
        """Returns cosines of any shape, scaled."""
        return cosines * self.log_scale.exp().clamp(max=_MAX_SCALE)
