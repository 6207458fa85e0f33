"""A frozen text encoder: BERT (Devlin et al. 2019), whose mean pooling embeds sentences.

Weights and vocabulary are one file in the folder of every policy trained with it; its sha256 identifies the encoder.
"""

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor
from torch.nn import functional

from freerein.errors import InvalidInput, quoted
from freerein.learning import tensor_files
from freerein_imitation.methods.language.texts.wordpiece import WordPieceTokenizer

_VOCABULARY = "vocabulary"
_HEAD_SIZE = 32  # of every MiniLM
_EPSILON = 1e-12


class TextEncoder:
    """Encodes texts and their tokens; on the CPU, since a text is encoded once per goal.

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
            (self.size,) = self.embed(self.tokenize("a text shows whether the weights fit together")).shape
        except (KeyError, IndexError, ValueError, RuntimeError) as error:
            raise InvalidInput(
                f"A text encoder's file must hold a BERT encoder and its vocabulary; got: {quoted(repr(error))}.",
                hint="Fit the model again, or restore its folder from a copy.",
            ) from error

    def tokenize(self, text: str) -> Tensor:
        """Returns the ids of a text's L tokens, [CLS] and [SEP] included, int64 (L,), L at most `MAX_TOKENS`."""
        return torch.tensor(self._tokenizer(text))

    def embed(self, tokens: Tensor) -> Tensor:
        """Returns the embedding of a text by its tokens, int64 (L,): a unit vector, float32 (size,)."""
        return functional.normalize(self._states(tokens, layers=self._layers).mean(dim=0), dim=0)

    def token_states(self, tokens: Tensor) -> Tensor:
        """Returns the states of tokens, int64 (..., L), half-way through the layers: float32 (..., L, size).

        There a token still says which word it is of, and already what that word does in its text.
        """
        return self._states(tokens, layers=self._layers // 2)

    def word_embeddings(self, tokens: Tensor) -> Tensor:
        """Returns the embeddings of tokens, int64 (..., L), whatever text they are part of: float32 (..., L, size)."""
        return self._weights["tokens.weight"][tokens]

    @torch.no_grad()
    def _states(self, tokens: Tensor, *, layers: int) -> Tensor:
        x = self.word_embeddings(tokens) + self._weights["positions.weight"][: tokens.shape[-1]]  # (..., L, size)
        x = self._norm(x, "norm")
        for layer in range(layers):
            x = self._layer(x, f"layers.{layer}")
        return x

    def _layer(self, x: Tensor, name: str) -> Tensor:
        """Self-attention and feed-forward layer, each with a residual connection and a norm: float32 (..., L, size)."""
        query, key, value = (self._heads(x, f"{name}.{each}") for each in ("query", "key", "value"))
        attended = functional.scaled_dot_product_attention(query, key, value)  # (..., heads, L, head size)
        projected = self._linear(attended.transpose(-3, -2).flatten(-2), f"{name}.attention_output")
        x = self._norm(x + projected, f"{name}.attention_norm")
        inner = functional.gelu(self._linear(x, f"{name}.intermediate"))  # (..., L, intermediate size)
        return self._norm(x + self._linear(inner, f"{name}.output"), f"{name}.output_norm")

    def _heads(self, x: Tensor, name: str) -> Tensor:
        heads = self._linear(x, name).view(*x.shape[:-1], -1, _HEAD_SIZE)  # (..., L, heads, head size)
        return heads.transpose(-3, -2)

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
