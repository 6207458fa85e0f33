"""A frozen text tower: BERT's encoder (Devlin et al. 2019), the mean of what comes out being the code of a sentence.

Tower and vocabulary are one file, which lies in the folder of every policy that was learned with it: whoever acts needs
nothing else, and the file's sha256 says which tower it was.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn import functional

from freerein.errors import InvalidInput
from freerein.learning import tensor_files
from freerein_imitation.model.word_pieces import WordPieces

_VOCABULARY = "vocabulary"
_HEAD = 32  # numbers per attention head of every MiniLM
_EPSILON = 1e-12


class TextTower:
    """Sentences to codes of length 1; sentences that mean the same have codes that lie close to one another.

    It computes on the CPU: a sentence is read once, and a robot asks about frames.

    Args:
        data: A file that `tower_file` made; read as untrusted.

    Attributes:
        width: Numbers in a code.

    Raises:
        InvalidInput: It is none.
    """

    def __init__(self, data: bytes) -> None:
        try:
            weights = tensor_files.parse(data)
            self._pieces = WordPieces(weights.pop(_VOCABULARY).numpy().tobytes().decode().split("\n"))
            self._weights = {name: each.float() for name, each in weights.items()}
            self._layers = len({name.split(".")[1] for name in weights if name.startswith("layers.")})
            (self.width,) = self._code("a sentence shows whether the weights fit together").shape
        except (KeyError, IndexError, ValueError, RuntimeError) as error:
            raise InvalidInput(
                "A text tower's file must hold the weights of a BERT encoder and its vocabulary; it does not.",
                hint="Fit the model again, or restore its folder from a copy.",
            ) from error

    def __call__(self, texts: Sequence[str]) -> npt.NDArray[np.float32]:
        """Returns the codes of texts, float32 (N, width): one by one, so that none depends on the others."""
        codes = [self._code(text).numpy() for text in texts]
        return np.stack(codes) if codes else np.empty((0, self.width), np.float32)

    @torch.inference_mode()
    def _code(self, text: str) -> Tensor:
        ids = torch.tensor(self._pieces(text))  # (L,)
        x = self._weights["words.weight"][ids] + self._weights["places.weight"][: len(ids)]  # (L, width)
        x = self._norm(x, "norm")
        for layer in range(self._layers):
            x = self._layer(x, f"layers.{layer}")
        return functional.normalize(x.mean(dim=0), dim=0)

    def _layer(self, x: Tensor, name: str) -> Tensor:
        """Self-attention and two linear layers, each added to what came in, then normalised: float32 (L, width)."""
        query, key, value = (self._heads(x, f"{name}.{each}") for each in ("query", "key", "value"))
        mixed = functional.scaled_dot_product_attention(query, key, value)  # (heads, L, head)
        x = self._norm(x + self._linear(mixed.transpose(0, 1).flatten(1), f"{name}.out"), f"{name}.attended")
        inner = functional.gelu(self._linear(x, f"{name}.inner"))  # (L, inner)
        return self._norm(x + self._linear(inner, f"{name}.outer"), f"{name}.norm")

    def _heads(self, x: Tensor, name: str) -> Tensor:
        return self._linear(x, name).view(len(x), -1, _HEAD).transpose(0, 1)  # (heads, L, head)

    def _linear(self, x: Tensor, name: str) -> Tensor:
        return functional.linear(x, self._weights[f"{name}.weight"], self._weights[f"{name}.bias"])

    def _norm(self, x: Tensor, name: str) -> Tensor:
        weight, bias = self._weights[f"{name}.weight"], self._weights[f"{name}.bias"]
        return functional.layer_norm(x, weight.shape, weight, bias, _EPSILON)


def tower_file(weights: Mapping[str, Tensor], vocabulary: Sequence[str]) -> bytes:
    """Returns a tower as a file. Weights are kept in half precision: the cosine to a code of whole ones is above 0.999.

    Args:
        weights: `words` (V, width), `places` (P, width), P at least `MAX_TOKENS`, `norm`, and by layer (`layers.0`)
            `query`, `key`, `value`, `out`, `attended`, `inner`, `outer` and `norm`: each a `weight`, most a `bias`.
        vocabulary: Pieces of words, in the order of their numbers.
    """
    pieces = torch.frombuffer(bytearray("\n".join(vocabulary).encode()), dtype=torch.uint8)
    return tensor_files.dump({_VOCABULARY: pieces, **{name: each.half() for name, each in weights.items()}})
