"""CLIP's text encoder, made small: a transformer that looks back only, read at the text's end."""

import torch
from torch import Tensor, nn
from torch.nn import functional

from freerein_reward.model.tokenizer import END, MAX_TOKENS

_HEAD_CHANNELS = 16


class TextTower(nn.Module):
    """Embeds texts.

    Args:
        tokens: How many different ones there are.
        width: Channels of the transformer; a multiple of 16.
        depth: Layers.
        features: How many numbers an embedding has.
    """

    def __init__(self, *, tokens: int, width: int, depth: int, features: int) -> None:
        super().__init__()
        self.words = nn.Embedding(tokens, width)
        self.places = nn.Embedding(MAX_TOKENS, width)
        self.layers = nn.ModuleList(_Layer(width) for _ in range(depth))
        self.norm = nn.LayerNorm(width)
        self.head = nn.Linear(width, features)

    def forward(self, ids: Tensor) -> Tensor:
        """Returns the embeddings (K, D), not yet of length 1, of tokens int64 (K, L), L at most 77."""
        x = self.words(ids) + self.places.weight[: ids.shape[1]]  # (K, L, C)
        for layer in self.layers:
            x = layer(x)
        last = (ids == END).to(torch.int64).argmax(dim=1)  # (K,)
        embeddings: Tensor = self.head(self.norm(x[torch.arange(len(ids), device=ids.device), last]))  # (K, D)
        return embeddings


class _Layer(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        self._heads = width // _HEAD_CHANNELS
        self.before_attention = nn.LayerNorm(width)
        self.mix = nn.Linear(width, 3 * width)
        self.out = nn.Linear(width, width)
        self.before_body = nn.LayerNorm(width)
        self.body = nn.Sequential(nn.Linear(width, 2 * width), nn.GELU(), nn.Linear(2 * width, width))

    def forward(self, x: Tensor) -> Tensor:
        """Returns (K, L, C) of x (K, L, C)."""
        query, key, value = (
            part.unflatten(2, (self._heads, _HEAD_CHANNELS)).transpose(1, 2)  # (K, heads, L, C / heads)
            for part in self.mix(self.before_attention(x)).chunk(3, dim=2)
        )
        seen = functional.scaled_dot_product_attention(query, key, value, is_causal=True)
        x = x + self.out(seen.transpose(1, 2).flatten(start_dim=2))
        changed: Tensor = x + self.body(self.before_body(x))
        return changed
