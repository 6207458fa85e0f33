"""A CLIP-style dual encoder: an image encoder and a text encoder, compared by the product of their embeddings.

Without phrases it compares what an image and a text are about, by cosine similarity, as CLIP does. With phrases it
compares what the image shows of a pair of phrases with what the text says of them: a cosine similarity per pair.
"""

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional

from freerein.learning.encoders.clip import ClipImageEncoder
from freerein.learning.image_statistics import image_statistics, statistics_sizes
from freerein.learning.in_distribution import InDistribution
from freerein.learning.train_state import N
from freerein.types.common import Camera
from freerein_reward.model.known_phrases import KnownPhrases
from freerein_reward.model.spec import DualEncoderSpec
from freerein_reward.model.text_encoder import ClipTextEncoder
from freerein_reward.model.tokenizer import Tokenizer

_INITIAL_SCALE, _MAX_SCALE = 1 / 0.07, 100.0


class DualEncoder(nn.Module):
    """A small CLIP."""

    def __init__(self, spec: DualEncoderSpec) -> None:
        super().__init__()
        self.spec = spec
        self.tokenizer = Tokenizer(spec.vocabulary)
        self.image = ClipImageEncoder(spec.image)
        self.text = ClipTextEncoder(spec, tokens=self.tokenizer.size)
        self.temperature = Temperature()
        self.in_distribution = InDistribution(*_statistics_sizes(spec)) if spec.phrases else None
        self.known_phrases = None if spec.phrases else KnownPhrases(spec.vocabulary, spec.embedding_dim)

    def embed_images(self, views: Tensor) -> Tensor:
        """Returns the embeddings, float32 (N, D), of V camera views, uint8 (N, V, image_size, image_size, 3)."""
        embeddings = self.image(views.flatten(end_dim=1)).unflatten(0, views.shape[:2]).mean(dim=1)  # (N, D)
        return embeddings if self.spec.phrases else functional.normalize(embeddings, dim=1)

    def distance(self, views: Tensor) -> Tensor:
        """Returns how far views, uint8 (N, V, H, W, 3), are from the fit's: float32 (N,), 0 for a grounding model."""
        if self.in_distribution is None:
            return views.new_zeros(len(views), dtype=torch.float32)
        return self.in_distribution.distance(self.statistics(views))

    def statistics(self, views: Tensor) -> Tensor:
        """Returns the in-distribution score's inputs, float32 (N, D), of views uint8 (N, V, H, W, 3)."""
        by_camera = {str(number): view for number, view in enumerate(views.unbind(dim=1))}
        return image_statistics(by_camera, colours=self.spec.scores_colours)

    def embed_texts(self, ids: Tensor) -> Tensor:
        """Returns the embeddings, float32 (K, D), of tokens int64 (K, L). Similarities with images are in [-1, 1]."""
        embeddings: Tensor = self.text(ids)
        return embeddings if self.spec.phrases else functional.normalize(embeddings, dim=1)

    def tokenize(self, texts: Sequence[str]) -> Tensor:
        """Returns the tokens of texts, int64 (K, L), on the network's device."""
        return torch.from_numpy(self.tokenizer(texts).ids).to(self.device)

    @property
    def device(self) -> torch.device:
        """Device of the parameters."""
        return self.temperature.log_scale.device


def _statistics_sizes(spec: DualEncoderSpec) -> tuple[int, ...]:
    size = spec.image_size
    return statistics_sizes([Camera(name, size, size, 3) for name in spec.cameras], colours=spec.scores_colours)


def channels_last(network: N) -> N:
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
