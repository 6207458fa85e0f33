"""Two towers, one for images and one for texts, whose embeddings are compared by their cosine (CLIP)."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from freerein.errors import InvalidInput
from freerein.learning.config import bounded
from freerein_reward.model.image_tower import SHRINKAGE, ImageTower
from freerein_reward.model.text_tower import TextTower
from freerein_reward.model.tokenizer import Tokenizer

_FIRST_SCALE, _MAX_SCALE = 1 / 0.07, 100.0
_MULTIPLE = 16


@dataclass(frozen=True, kw_only=True)
class DualEncoderSpec:
    """What a dual encoder sees and reads, and how large it is.

    Attributes:
        cameras: Whose frames it sees, one embedding for each that are averaged; one empty name for any image.
        vocabulary: The words of its training.
        side: Height and width of the images as the network sees them, in pixels; a multiple of 4.
        width: Channels of the image tower's stem; a multiple of 8.
        depth: Bottlenecks per stage of the image tower.
        heads: How many things the image tower asks the places of, for relations; 0 for what is seen, for nouns.
        hidden: Units of each of the two layers after it has places.
        text_width: Channels of the text tower; a multiple of 16.
        text_depth: Its layers.
        features: How many numbers an embedding has.
        presence_at: The heat of Grad-CAM at which a thing is as likely there as not; of a grounding model.

    Raises:
        InvalidInput: There are no cameras or no words, or a size is no such multiple.
    """

    cameras: tuple[str, ...]
    vocabulary: tuple[str, ...]
    side: int = bounded(64, least=16, most=512)
    width: int = bounded(8, least=8, most=128)
    depth: int = bounded(1, least=1, most=8)
    heads: int = bounded(0, least=0, most=512)
    hidden: int = bounded(256, least=1, most=4096)
    text_width: int = bounded(64, least=16, most=1024)
    text_depth: int = bounded(2, least=1, most=12)
    features: int = bounded(64, least=8, most=1024)
    presence_at: float = bounded(1.0, least=1e-6, most=1e6)

    def __post_init__(self) -> None:
        uneven = self.side % SHRINKAGE or self.width % 8 or self.text_width % _MULTIPLE
        if not self.cameras or not self.vocabulary or uneven:
            raise InvalidInput(
                "A dual encoder needs a camera, words, a side that 4 divides, a width that 8 and a text width that 16 "
                f"divides; got {len(self.cameras)} cameras, {len(self.vocabulary)} words, {self.side}, {self.width} "
                f"and {self.text_width}.",
                hint="Leave sizes out for the defaults.",
            )


class DualEncoder(nn.Module):
    """CLIP in small.

    Args:
        spec: What it sees and reads.
    """

    def __init__(self, spec: DualEncoderSpec) -> None:
        super().__init__()
        self.spec = spec
        self.tokenizer = Tokenizer(spec.vocabulary)
        self.image = ImageTower(
            width=spec.width, depth=spec.depth, heads=spec.heads, hidden=spec.hidden, features=spec.features
        )
        self.text = TextTower(
            tokens=self.tokenizer.size, width=spec.text_width, depth=spec.text_depth, features=spec.features
        )
        self.temperature = Temperature()

    def embed_images(self, views: Tensor) -> Tensor:
        """Returns the embeddings, float32 (N, D), each of length 1, of views uint8 (N, V, side, side, 3)."""
        embeddings = self.image(views.flatten(end_dim=1)).unflatten(0, views.shape[:2])  # (N, V, D)
        return functional.normalize(embeddings.mean(dim=1), dim=1)

    def embed_texts(self, ids: Tensor) -> Tensor:
        """Returns the embeddings, float32 (K, D), each of length 1, of tokens int64 (K, L)."""
        return functional.normalize(self.text(ids), dim=1)


def channels_last(network: DualEncoder) -> DualEncoder:
    """Returns the network itself, its convolutions laid out in memory so that they take half the time on a CPU."""
    return network.to(memory_format=torch.channels_last)  # type: ignore[call-overload, no-any-return]  # torch's stub


class Temperature(nn.Module):
    """What cosines are multiplied by before they are compared: learnt, and 100 at most, as CLIP's."""

    def __init__(self) -> None:
        super().__init__()
        self.log_scale = nn.Parameter(torch.empty(()))

    def initialise(self, generator: torch.Generator) -> None:
        """Sets the first value, which is not random."""
        nn.init.constant_(self.log_scale, math.log(_FIRST_SCALE))

    def forward(self, cosines: Tensor) -> Tensor:
        """Returns cosines of any shape, scaled."""
        return cosines * self.log_scale.exp().clamp(max=_MAX_SCALE)
