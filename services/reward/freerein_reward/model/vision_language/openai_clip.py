"""CLIP with a ResNet, from a folder with weights in OpenAI's layout.

<folder>/model.safetensors   the state dict as published, at any precision
         merges.txt          merges of the tokenizer; or bpe_simple_vocab_16e6.txt
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn import functional

from freerein.errors import InvalidInput
from freerein.regular_files import read_regular
from freerein_reward.model.dual_encoder_model import preprocess
from freerein_reward.model.vision_language.interface import TracedMaps
from freerein_reward.model.vision_language.openai_network import Clip, ClipShape
from freerein_reward.model.vision_language.openai_tokenizer import BpeTokenizer
from freerein_reward.model.vision_language.source_folder import read_weights

MERGES = ("merges.txt", "bpe_simple_vocab_16e6.txt")
MEAN = (0.48145466, 0.4578275, 0.40821073)
STANDARD_DEVIATION = (0.26862954, 0.26130258, 0.27577711)
"""Statistics of the pixels that CLIP was trained on, for each of red, green and blue."""

_ATTRIBUTES = ("input_resolution", "context_length", "vocab_size")  # numbers that the published archive has, too
_NAMED = 3
_CELL_PIXELS = 32
_BLOCKS = "transformer.resblocks."


class OpenAIClip:
    """A CLIP model with a ResNet; see `VisionLanguageModel`. Attention pooling has value maps in closed form."""

    def __init__(self, network: Clip, tokenizer: BpeTokenizer, shape: ClipShape) -> None:
        self._network = network.eval().requires_grad_(requires_grad=False)
        self._tokenizer = tokenizer
        self.image_size = _CELL_PIXELS * shape.cells
        self.dimension = shape.dimension

    @property
    def device(self) -> torch.device:
        """Device of the weights."""
        return self._network.logit_scale.device

    def preprocess(self, image: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
        """Returns an image uint8 (h, w, 1 or 3), of any size, as the model's, uint8 (H, W, 3).

        The whole image is stretched; CLIP crops its middle, outside of which things would have no place.
        """
        return preprocess(image, size=self.image_size)

    def embed_images(self, images: Tensor) -> Tensor:
        """Returns the embeddings, float32 (N, D) of length 1, of images uint8 (N, H, W, 3)."""
        return functional.normalize(self._network.visual.attnpool(self.last_maps(images)), dim=1)

    def embed_texts(self, texts: Sequence[str]) -> Tensor:
        """Returns the embeddings, float32 (K, D) of length 1, of texts."""
        ids, _ = self._tokenizer(texts)
        return functional.normalize(self._network.embed_texts(torch.from_numpy(ids).to(self.device)), dim=1)

    def truncated(self, texts: Sequence[str]) -> npt.NDArray[np.bool_]:
        """Returns whether each text is longer than the model reads, bool (K,)."""
        return self._tokenizer(texts)[1]

    def last_maps(self, images: Tensor) -> Tensor:
        """Returns the output of the last stage, float32 (N, C, h, w), of images uint8 (N, H, W, 3)."""
        return self._network.visual.feature_maps(normalised_pixels(images, MEAN, STANDARD_DEVIATION))

    def traced_maps(self, images: Tensor) -> TracedMaps:
        """Returns these maps, and the embeddings as a function of them, with attention and length held fixed."""
        maps = self.last_maps(images).detach().requires_grad_()
        embeddings = self._network.visual.attnpool(maps, fixed_attention=True)
        return TracedMaps(maps, embeddings / embeddings.detach().norm(dim=1, keepdim=True))

    def channel_weights(self, directions: Tensor) -> Tensor:
        """Returns Grad-CAM's channel weights, but for a factor: float32 (P, C) of directions (P, D)."""
        pool = self._network.visual.attnpool
        weights: Tensor = directions @ pool.c_proj.weight @ pool.v_proj.weight
        return weights


def load_openai_clip(folder: Path, device: torch.device) -> OpenAIClip:
    """Returns the model in a folder.

    Raises:
        InvalidInput: A file is missing or malformed, or a weight is missing, unknown, or of another shape.
    """
    weights = {name: each.float() for name, each in read_weights(folder).items() if name not in _ATTRIBUTES}
    shape = clip_shape(weights)
    with torch.device("meta"):  # allocates nothing: what is too large has other shapes
        network = Clip(shape)
    expected = network.state_dict()
    _check_keys(expected, weights)
    network.load_state_dict({name: each.to(expected[name].dtype) for name, each in weights.items()}, assign=True)
    merges = next((folder / name for name in MERGES if (folder / name).exists()), None)
    if merges is None:
        raise InvalidInput(
            f"`source` must have the merges of its tokenizer, {' or '.join(MERGES)}; it has neither.",
            field="source",
            hint="Copy one from where the weights are from; unpack it where it is a .gz file.",
        )
    text = read_regular(merges, name=merges.name).decode(errors="replace")
    tokenizer = BpeTokenizer(text, tokens=shape.tokens, length=shape.text_length)
    return OpenAIClip(network.to(device), tokenizer, shape)


def clip_shape(weights: Mapping[str, Tensor]) -> ClipShape:
    """Returns the sizes of a model, from the shapes of its weights; InvalidInput where they are of no CLIP ResNet."""
    depths = tuple(_count(weights, f"visual.layer{stage}.") for stage in range(1, 5))
    try:
        tokens, text_width = weights["token_embedding.weight"].shape
        shape = ClipShape(
            dimension=weights["text_projection"].shape[1],
            width=weights["visual.conv3.weight"].shape[0],
            depths=(depths[0], depths[1], depths[2], depths[3]),
            cells=round((weights["visual.attnpool.positional_embedding"].shape[0] - 1) ** 0.5),
            text_width=text_width,
            text_depth=_count(weights, _BLOCKS),
            text_length=weights["positional_embedding"].shape[0],
            tokens=tokens,
        )
    except (KeyError, IndexError, ValueError) as error:
        raise _wrong_weights(f"could not be read: {error} is missing or has another number of axes") from None
    if not all(depths) or shape.width % 2 or shape.text_width % 64 or shape.cells < 1:
        raise _wrong_weights(
            f"has {depths} bottlenecks, {shape.width} channels, {shape.text_width} of texts and {shape.cells} cells"
        )
    return shape


def _count(weights: Mapping[str, Tensor], prefix: str) -> int:
    """Returns the number of numbered parts with a prefix."""
    numbers = {name.removeprefix(prefix).split(".")[0] for name in weights if name.startswith(prefix)}
    return sum(number.isdigit() for number in numbers)


def _check_keys(expected: Mapping[str, Tensor], weights: Mapping[str, Tensor]) -> None:
    """Raises InvalidInput unless weights have exactly the names and shapes of a network's."""
    found = {
        "misses": sorted(expected.keys() - weights.keys()),
        "has the unknown": sorted(weights.keys() - expected.keys()),
        "has, of another shape,": [
            f"{name} {tuple(weights[name].shape)} for {tuple(expected[name].shape)}"
            for name in expected
            if name in weights and weights[name].shape != expected[name].shape
        ],
    }
    wrong = [f"{what} {', '.join(names[:_NAMED])}" for what, names in found.items() if names]
    if wrong:
        raise _wrong_weights("; it ".join(wrong))


def _wrong_weights(what: str) -> InvalidInput:
    return InvalidInput(
        f"`source` must have the weights of a CLIP ResNet in OpenAI's layout; it {what}.",
        field="source",
        hint="Save the state dict of the published model as it is; models of transformers have a config.json.",
    )


def normalised_pixels(images: Tensor, mean: Sequence[float], standard_deviation: Sequence[float]) -> Tensor:
    """Returns pixels float32 (N, 3, H, W), less a mean and divided by a deviation, of images uint8 (N, H, W, 3)."""
    centre, spread = (torch.tensor(each, device=images.device) for each in (mean, standard_deviation))
    return ((images.float() / 255 - centre) / spread).permute(0, 3, 1, 2)
