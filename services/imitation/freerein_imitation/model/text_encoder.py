"""A frozen sentence encoder: BERT (Devlin et al. 2019) with mean pooling.

Weights and vocabulary are one file in the folder of every policy trained with it; its sha256 identifies the encoder.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn import functional

from freerein.errors import InvalidInput
from freerein.learning import tensor_files
from freerein_imitation.model.wordpiece import WordPieceTokenizer

_VOCABULARY = "vocabulary"
_HEAD_SIZE = 32  # of every MiniLM
_EPSILON = 1e-12


class TextEncoder:
    """Embeds texts as unit vectors; on the CPU, since a text is encoded once per goal.

    Args:
        data: A file written by `pack`; read as untrusted.

    Attributes:
        size: Numbers per embedding.

    Raises:
        InvalidInput: The file is not a text encoder.
    """

    def __init__(self, data: bytes) -> None:
        try:
            weights = tensor_files.parse(data)
            self._tokenizer = WordPieceTokenizer(weights.pop(_VOCABULARY).numpy().tobytes().decode().split("\n"))
            self._weights = {name: each.float() for name, each in weights.items()}
            self._layers = len({name.split(".")[1] for name in weights if name.startswith("layers.")})
            (self.size,) = self._embed("a text shows whether the weights fit together").shape
        except (KeyError, IndexError, ValueError, RuntimeError) as error:
            raise InvalidInput(
                "A text encoder's file must hold the weights of a BERT encoder and its vocabulary; it does not.",
                hint="Fit the model again, or restore its folder from a copy.",
            ) from error

    def __call__(self, texts: Sequence[str]) -> npt.NDArray[np.float32]:
        """Returns text embeddings, float32 (N, size); each is independent of the others."""
        embeddings = [self._embed(text).numpy() for text in texts]
        return np.stack(embeddings) if embeddings else np.empty((0, self.size), np.float32)

    @torch.inference_mode()
    def _embed(self, text: str) -> Tensor:
        ids = torch.tensor(self._tokenizer(text))  # (L,)
        x = self._weights["tokens.weight"][ids] + self._weights["positions.weight"][: len(ids)]  # (L, size)
        x = self._norm(x, "norm")
        for layer in range(self._layers):
            x = self._layer(x, f"layers.{layer}")
        return functional.normalize(x.mean(dim=0), dim=0)

    def _layer(self, x: Tensor, name: str) -> Tensor:
        """Self-attention and feed-forward layer, each with a residual connection and a norm: float32 (L, size)."""
        query, key, value = (self._heads(x, f"{name}.{each}") for each in ("query", "key", "value"))
        attended = functional.scaled_dot_product_attention(query, key, value)  # (heads, L, head size)
        projected = self._linear(attended.transpose(0, 1).flatten(1), f"{name}.attention_output")
        x = self._norm(x + projected, f"{name}.attention_norm")
        inner = functional.gelu(self._linear(x, f"{name}.intermediate"))  # (L, intermediate size)
        return self._norm(x + self._linear(inner, f"{name}.output"), f"{name}.output_norm")

    def _heads(self, x: Tensor, name: str) -> Tensor:
        return self._linear(x, name).view(len(x), -1, _HEAD_SIZE).transpose(0, 1)  # (heads, L, head size)

    def _linear(self, x: Tensor, name: str) -> Tensor:
        return functional.linear(x, self._weights[f"{name}.weight"], self._weights[f"{name}.bias"])

    def _norm(self, x: Tensor, name: str) -> Tensor:
        weight, bias = self._weights[f"{name}.weight"], self._weights[f"{name}.bias"]
        return functional.layer_norm(x, weight.shape, weight, bias, _EPSILON)


def pack(weights: Mapping[str, Tensor], vocabulary: Sequence[str]) -> bytes:
    """Returns a text encoder as a file, with weights in half precision: embeddings change by a cosine under 0.001.

    Args:
        weights: `tokens` (V, size), `positions` (P, size), P at least `MAX_TOKENS`, `norm`, and by layer (`layers.0`)
            `query`, `key`, `value`, `attention_output`, `attention_norm`, `intermediate`, `output` and `output_norm`;
            each a `weight`, most a `bias`.
        vocabulary: Word pieces in the order of their ids.
    """
    pieces = torch.frombuffer(bytearray("\n".join(vocabulary).encode()), dtype=torch.uint8)
    return tensor_files.dump({_VOCABULARY: pieces, **{name: each.half() for name, each in weights.items()}})
