"""CLIP with a vision transformer, and SigLIP, by the library `transformers` from a folder as it saves them.

<folder>/config.json                `model_type` clip or siglip
         model.safetensors
         tokenizer.json
         preprocessor_config.json   mean and deviation of pixels; those of the model type without the file

The classes are named here, not by the folder. Nothing is fetched. Attention is in the library's hands, so Grad-CAM is
by gradient: through the last layer, whose input CLIP's last maps are, or through the attention pooling of SigLIP.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn
from torch.nn import functional

from freerein.errors import InvalidInput, Unimplemented, quoted
from freerein.goal_text import words
from freerein_reward.model.dual_encoder_model import preprocess
from freerein_reward.model.vision_language.interface import TracedMaps
from freerein_reward.model.vision_language.openai_clip import MEAN, STANDARD_DEVIATION, normalised_pixels
from freerein_reward.model.vision_language.source_folder import check_folder, read_json

CONFIG, TOKENIZER, PREPROCESSOR = "config.json", "tokenizer.json", "preprocessor_config.json"
_HALF = (0.5, 0.5, 0.5)
_STATISTICS: Mapping[str, tuple[Sequence[float], Sequence[float]]] = {
    "clip": (MEAN, STANDARD_DEVIATION),
    "siglip": (_HALF, _HALF),
}
_NAMED = 3


class TransformersModel:
    """A CLIP or SigLIP model with a vision transformer; see `VisionLanguageModel`."""

    def __init__(self, network: Any, tokenizer: Any, statistics: tuple[Sequence[float], Sequence[float]]) -> None:
        self._network = network.eval().requires_grad_(requires_grad=False)
        self._tokenizer = tokenizer
        self._statistics = statistics
        vision, text = network.config.vision_config, network.config.text_config
        self._length: int = text.max_position_embeddings
        self._is_clip = network.config.model_type == "clip"
        self._padding = text.eos_token_id if self._is_clip else text.pad_token_id
        self._cells = vision.image_size // vision.patch_size
        self.image_size: int = vision.image_size
        self.dimension = int(self.embed_texts(["a thing"]).shape[1])

    @property
    def device(self) -> torch.device:
        """Device of the weights."""
        device: torch.device = self._network.device
        return device

    def preprocess(self, image: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
        """Returns an image uint8 (h, w, 1 or 3), of any size, as the model's, uint8 (H, W, 3), stretched."""
        return preprocess(image, size=self.image_size)

    def embed_images(self, images: Tensor) -> Tensor:
        """Returns the embeddings, float32 (N, D) of length 1, of images uint8 (N, H, W, 3)."""
        pixels = normalised_pixels(images, *self._statistics)
        return functional.normalize(self._network.get_image_features(pixels).pooler_output, dim=1)

    def embed_texts(self, texts: Sequence[str]) -> Tensor:
        """Returns the embeddings, float32 (K, D) of length 1, of texts."""
        ids = torch.full((len(texts), self._length), self._padding, dtype=torch.int64)
        for row, found in zip(ids, map(self._tokens, texts), strict=True):
            kept = found if len(found) <= self._length else [*found[: self._length - 1], found[-1]]
            row[: len(kept)] = torch.tensor(kept)
        embeddings = self._network.get_text_features(ids.to(self.device)).pooler_output
        return functional.normalize(embeddings, dim=1)

    def truncated(self, texts: Sequence[str]) -> npt.NDArray[np.bool_]:
        """Returns whether each text is longer than the model reads, bool (K,)."""
        return np.array([len(self._tokens(text)) > self._length for text in texts])

    def last_maps(self, images: Tensor) -> Tensor:
        """Returns the patches' states, float32 (N, C, h, w), of images uint8 (N, H, W, 3)."""
        return self.traced_maps(images).maps.detach()

    def traced_maps(self, images: Tensor) -> TracedMaps:
        """Returns these states, and the embeddings as a function of them."""
        with torch.enable_grad(), self._mapped() as maps:
            embeddings = self.embed_images(images)
        return TracedMaps(maps[0], embeddings)

    def channel_weights(self, _directions: Tensor) -> None:
        """Returns None: there is no closed form."""

    @contextmanager
    def _mapped(self) -> Iterator[list[Tensor]]:
        """While the block lasts, makes the patches' states a leaf of the graph, which it adds to the list yielded."""
        maps: list[Tensor] = []
        vision, cells = self._network.vision_model, self._cells

        def replaced(states: Tensor) -> Tensor:
            first = states.shape[1] - cells**2  # a class token, or none
            patches = states[:, first:].transpose(1, 2).reshape(len(states), -1, cells, cells)
            own = patches.detach().requires_grad_()
            maps.append(own)
            return torch.cat([states[:, :first], own.flatten(start_dim=2).transpose(1, 2)], dim=1)

        def before(_module: nn.Module, given: tuple[Any, ...], options: dict[str, Any]) -> Any:
            return (replaced(given[0]), *given[1:]), options

        if self._is_clip:
            handle = vision.encoder.layers[-1].register_forward_pre_hook(before, with_kwargs=True)
        else:
            handle = vision.post_layernorm.register_forward_hook(lambda _module, _given, states: replaced(states))
        try:
            yield maps
        finally:
            handle.remove()

    def _tokens(self, text: str) -> list[int]:
        found: list[int] = self._tokenizer.encode(" ".join(words(text))).ids
        return found


def load_transformers_model(folder: Path, device: torch.device) -> TransformersModel:
    """Returns the model in a folder.

    Raises:
        InvalidInput: A file is missing or malformed, the folder asks for code, the model is another one than CLIP and
            SigLIP, or a weight is missing, unknown, or of another shape.
        Unimplemented: `transformers` is not installed.
    """
    check_folder(folder)
    config = read_json(folder, CONFIG)
    kind = str(config.get("model_type"))
    if kind not in _STATISTICS:
        raise InvalidInput(
            f"`source` must be a {' or '.join(_STATISTICS)} model; its {CONFIG} says {kind[:32]}.",
            field="source",
            hint="Models with a ResNet in OpenAI's layout have no config.json.",
        )
    transformers, tokenizers = _libraries()
    transformers.utils.logging.disable_progress_bar()
    if not (folder / TOKENIZER).is_file():
        raise InvalidInput(
            f"`source` must have {TOKENIZER}; it has none.",
            field="source",
            hint="Save the tokenizer with transformers, as a fast one.",
        )
    model_class = {"clip": transformers.CLIPModel, "siglip": transformers.SiglipModel}[kind]
    try:
        network, loaded = model_class.from_pretrained(
            folder,
            local_files_only=True,
            use_safetensors=True,
            trust_remote_code=False,
            dtype=torch.float32,
            output_loading_info=True,
        )
        tokenizer = tokenizers.Tokenizer.from_file(str(folder / TOKENIZER))
    except Exception as error:  # the libraries raise many kinds for files that are damaged
        raise _unreadable(type(error).__name__) from None
    wrong = [
        f"{what.removesuffix('_keys')} {', '.join(map(str, [*names][:_NAMED]))}"
        for what, names in loaded.items()
        if names
    ]
    if wrong:
        raise _unreadable("; ".join(wrong))
    if tokenizer.get_vocab_size() > network.config.text_config.vocab_size:
        raise _unreadable(f"{TOKENIZER} has more tokens than the model")
    if kind == "siglip" and not network.config.vision_config.vision_use_head:
        raise _unreadable("it has no attention pooling")
    return TransformersModel(network.to(device), tokenizer, _statistics(folder, kind))


def _libraries() -> tuple[Any, Any]:
    try:
        import tokenizers
        import transformers
    except ImportError:
        raise Unimplemented(
            "CLIP and SigLIP of transformers need that library; it is not installed.",
            field="source",
            hint="Install freerein-reward[transformers].",
        ) from None
    return transformers, tokenizers


def _statistics(folder: Path, kind: str) -> tuple[Sequence[float], Sequence[float]]:
    """Returns mean and deviation of pixels, for each of red, green and blue."""
    if not (folder / PREPROCESSOR).exists():
        return _STATISTICS[kind]
    document = read_json(folder, PREPROCESSOR)
    given = tuple(
        document.get(name, own) for name, own in zip(("image_mean", "image_std"), _STATISTICS[kind], strict=True)
    )
    if not all(
        isinstance(each, list | tuple) and len(each) == 3 and all(_is_number(x) for x in each) for each in given
    ):
        raise InvalidInput(
            f"`image_mean` and `image_std` of {PREPROCESSOR} must be three numbers each; got {quoted(str(given))}.",
            field="source",
            hint="Copy the file from where the model is from.",
        )
    mean, deviation = given
    return mean, deviation


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and 0 < value <= 1


def _unreadable(what: str) -> InvalidInput:
    return InvalidInput(
        f"`source` must hold a model as transformers saves it, with exactly its weights; it could not be read: {what}.",
        field="source",
        hint="Copy the folder again, or save the model again with save_pretrained.",
    )
