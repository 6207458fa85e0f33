"""A small version of CLIP's text encoder: a causal transformer, read at the end-of-text token."""

import torch
from torch import Tensor, nn
from torch.nn import functional

from freerein_reward.model.spec import DualEncoderSpec
from freerein_reward.model.tokenizer import END, MAX_TOKENS

_HEAD_CHANNELS = 16


class ClipTextEncoder(nn.Module):
    """Embeds texts of a vocabulary of `tokens` tokens."""

    def __init__(self, spec: DualEncoderSpec, *, tokens: int) -> None:
        super().__init__()
        width = spec.text_width
        self.token_embedding = nn.Embedding(tokens, width)
        self.position_embedding = nn.Embedding(MAX_TOKENS, width)
        self.layers = nn.ModuleList(_TransformerLayer(width) for _ in range(spec.text_depth))
        self.norm = nn.LayerNorm(width)
        self.head: nn.Linear | RelationHead = (
            RelationHead(width, len(spec.phrases), embedding_dim=spec.embedding_dim)
            if spec.phrases
            else nn.Linear(width, spec.embedding_dim)
        )

    def forward(self, ids: Tensor) -> Tensor:
        """Returns unnormalised embeddings (K, D) of tokens int64 (K, L), L at most 77."""
        embeddings: Tensor = self.head(self.states(ids))  # (K, D)
        return embeddings

    def states(self, ids: Tensor) -> Tensor:
        """Returns the state at the end-of-text token, (K, C), of tokens int64 (K, L)."""
        x = self.token_embedding(ids) + self.position_embedding.weight[: ids.shape[1]]  # (K, L, C)
        for layer in self.layers:
            x = layer(x)
        last = (ids == END).to(torch.int64).argmax(dim=1)  # (K,)
        states: Tensor = self.norm(x[torch.arange(len(ids), device=ids.device), last])
        return states

    @property
    def relation_head(self) -> "RelationHead":
        """The head of a model of relations; a TypeError without."""
        if not isinstance(self.head, RelationHead):
            raise TypeError("This text encoder has a linear head; expected a relation head.")
        return self.head


class RelationHead(nn.Module):
    """The two phrases and the relation that a text names: the counterpart of `RelationPool`.

    The embedding is the outer product of a distribution over the first phrase, one over the second, and a unit vector
    of the relation. Its product with an image's is the similarity of what is said and what is seen of that pair.
    """

    def __init__(self, width: int, phrases: int, *, embedding_dim: int) -> None:
        super().__init__()
        self.first = nn.Linear(width, phrases)
        self.second = nn.Linear(width, phrases)
        self.relation = nn.Linear(width, embedding_dim)

    def forward(self, states: Tensor) -> Tensor:
        """Returns the embeddings (K, P * P * D) of the encoder's states (K, C)."""
        first, second = self.first(states).softmax(dim=1), self.second(states).softmax(dim=1)  # (K, P) each
        relation = functional.normalize(self.relation(states), dim=1)  # (K, D)
        return torch.einsum("kp,kq,kd->kpqd", first, second, relation).flatten(start_dim=1)


class _TransformerLayer(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        self._heads = width // _HEAD_CHANNELS
        self.attention_norm = nn.LayerNorm(width)
        self.qkv = nn.Linear(width, 3 * width)
        self.out = nn.Linear(width, width)
        self.mlp_norm = nn.LayerNorm(width)
        self.mlp = nn.Sequential(nn.Linear(width, 2 * width), nn.GELU(), nn.Linear(2 * width, width))

    def forward(self, x: Tensor) -> Tensor:
        """Returns (K, L, C) of x (K, L, C)."""
        query, key, value = (
            part.unflatten(2, (self._heads, _HEAD_CHANNELS)).transpose(1, 2)  # (K, heads, L, C / heads)
            for part in self.qkv(self.attention_norm(x)).chunk(3, dim=2)
        )
        attended = functional.scaled_dot_product_attention(query, key, value, is_causal=True)
        x = x + self.out(attended.transpose(1, 2).flatten(start_dim=2))
        outputs: Tensor = x + self.mlp(self.mlp_norm(x))
        return outputs
