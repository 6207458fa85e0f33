"""The architecture of a dual encoder."""

from dataclasses import dataclass

from freerein.config import bounded
from freerein.errors import InvalidInput
from freerein.learning.encoders.clip import ClipImageSpec


@dataclass(frozen=True, kw_only=True)
class DualEncoderSpec:
    """Architecture of a dual encoder.

    Attributes:
        cameras: Camera names; the image embedding is the mean over cameras. One empty name for any image.
        vocabulary: Words of the training texts.
        phrases: Noun phrases of the training captions, whose relations are embedded; empty for a grounding model.
        image_size: Height and width of the image encoder's input, in pixels; a multiple of 4.
        width: Channels of the image encoder's stem; a multiple of 8.
        depth: Bottlenecks per stage of the image encoder.
        hidden_size: Units of each of the two hidden layers of the relation pooling.
        text_width: Channels of the text encoder; a multiple of 16.
        text_depth: Layers of the text encoder.
        embedding_dim: Dimension of the embeddings; with phrases, of each pair's.
        presence_heat: Grad-CAM peak at which an object is present with probability 1/2; of a grounding model.
        aspects: Height over width of each camera's frames in the fit; empty for any, as of models of before.
        scores_colours: Whether the in-distribution score sees colourfulness, too; not in models of before.

    Raises:
        InvalidInput: There are no cameras or no words, a size is not a multiple, or an aspect is missing or is not
            positive.
    """

    cameras: tuple[str, ...]
    vocabulary: tuple[str, ...]
    phrases: tuple[str, ...] = ()
    image_size: int = bounded(64, least=16, most=512)
    width: int = bounded(8, least=8, most=128)
    depth: int = bounded(1, least=1, most=8)
    hidden_size: int = bounded(64, least=1, most=4096)
    text_width: int = bounded(64, least=16, most=1024)
    text_depth: int = bounded(2, least=1, most=12)
    embedding_dim: int = bounded(64, least=4, most=1024)
    presence_heat: float = bounded(1.0, least=1e-6, most=1e6)
    aspects: tuple[float, ...] = ()
    scores_colours: bool = False

    def __post_init__(self) -> None:
        is_uneven = self.image_size % 4 or self.width % 8 or self.text_width % 16
        if not self.cameras or not self.vocabulary or is_uneven:
            raise InvalidInput(
                "A dual encoder needs a camera, a vocabulary, an `image_size` that is a multiple of 4, a `width` of 8 "
                f"and a `text_width` of 16; got {len(self.cameras)} cameras, {len(self.vocabulary)} words, "
                f"{self.image_size}, {self.width} and {self.text_width}.",
                hint="Leave sizes out for the defaults.",
            )
        if self.aspects and (len(self.aspects) != len(self.cameras) or min(self.aspects) <= 0):
            raise InvalidInput(
                f"`aspects` must be positive numbers, one for each of {len(self.cameras)} cameras; got "
                f"{len(self.aspects)}.",
                hint="Fit the model again, or restore its folder from a copy.",
            )

    @property
    def image(self) -> ClipImageSpec:
        """Sizes of the image encoder."""
        return ClipImageSpec(len(self.phrases), self.width, self.depth, self.hidden_size, self.embedding_dim)
