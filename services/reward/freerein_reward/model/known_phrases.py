"""Whether the grounding model knows what a phrase names.

A phrase's AUROC is measured on labelled reference images: those that show what its words name should be more similar
to it than others. Words without meaning separate some images by chance; their best AUROCs are the null distribution. A
phrase's score is the quantile of its AUROC there.
"""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from freerein.goal_text import words

KNOWN = 0.8
"""Quantile of the null distribution from which a phrase counts as known."""

REFERENCES = 2048
"""Reference images."""

NULL_TEXTS = 1000
"""Texts without meaning, whose best AUROCs are the null distribution."""


class KnownPhrases(nn.Module):
    """Scores phrases by a null distribution; it is fitted, not trained. Until `fit` every score is 1.

    Args:
        vocabulary: W words of the training texts.
        size: D, dimension of the embeddings.
        references: Reference images, N.

    Attributes:
        images: Embeddings of the reference images, float32 (N, D).
        shown: Whether an image shows what a word names, bool (N, W).
        nonsense: The null distribution, sorted AUROCs, float32 (`NULL_TEXTS`,); the name is that of stored models.
    """

    images: Tensor
    shown: Tensor
    nonsense: Tensor

    def __init__(self, vocabulary: Sequence[str], size: int, *, references: int = REFERENCES) -> None:
        super().__init__()
        self._places = {word: place for place, word in enumerate(vocabulary)}
        self.register_buffer("images", torch.zeros(references, size))
        self.register_buffer("shown", torch.zeros(references, len(vocabulary), dtype=torch.bool))
        self.register_buffer("nonsense", torch.zeros(NULL_TEXTS))

    @torch.no_grad()
    def fit(self, images: Tensor, shown: Tensor, null_texts: Tensor) -> None:
        """Sets the reference images and the null distribution.

        Args:
            images: Embeddings of the reference images, float32 (N, D).
            shown: Whether an image shows what a word of the vocabulary names, bool (N, W); all False for a word that
                names nothing.
            null_texts: Embeddings of texts without meaning, float32 (`NULL_TEXTS`, D).
        """
        self.images.copy_(images)
        self.shown.copy_(shown)
        self.nonsense.copy_(self.best_auroc(null_texts).sort().values)

    @torch.no_grad()
    def best_auroc(self, texts: Tensor) -> Tensor:
        """Returns the best AUROC (K,) of each text, (K, D), over the words of the vocabulary."""
        naming = self.shown[:, self.shown.any(dim=0)]  # (N, names)
        return _aurocs(texts @ self.images.T, naming).amax(dim=1)

    @torch.no_grad()
    def forward(self, phrases: Sequence[str], texts: Tensor) -> Tensor:
        """Returns the score of each phrase in [0, 1], float32 (P,); 0 where it names nothing.

        `texts` are the embeddings of the phrases, float32 (P, D).
        """
        if not self.shown.any():
            return texts.new_ones(len(phrases))
        aurocs = [
            self._auroc(phrase, similarities)
            for phrase, similarities in zip(phrases, texts @ self.images.T, strict=True)
        ]
        return self.rank(torch.stack(aurocs))

    def rank(self, aurocs: Tensor) -> Tensor:
        """Returns the quantile of each AUROC (K,) in the null distribution: float32 (K,)."""
        return torch.searchsorted(self.nonsense, aurocs) / len(self.nonsense)

    def names(self) -> tuple[str, ...]:
        """Returns the words of the vocabulary that name something which a reference image shows."""
        return tuple(word for word, place in self._places.items() if self.shown[:, place].any())

    def judges(self, phrase: str) -> bool:
        """Returns whether a phrase has a word that names something which a reference image shows."""
        return not {*words(phrase)}.isdisjoint(self.names())

    def _auroc(self, phrase: str, similarities: Tensor) -> Tensor:
        """Returns the AUROC, a scalar, of similarities (N,) for images that show what all words of a phrase name."""
        naming = [place for word in words(phrase) if (place := self._places.get(word)) is not None]
        named = self.shown[:, [place for place in naming if self.shown[:, place].any()]]  # (N, names)
        is_shown = named.all(dim=1) if named.shape[1] else named.any(dim=1)
        return _aurocs(similarities[None], is_shown[:, None])[0, 0]


def _aurocs(similarities: Tensor, shown: Tensor) -> Tensor:
    """Returns the area under the ROC curve of similarities (K, N) for each column of bool (N, W): float32 (K, W).

    It is 0 for a column without a True.
    """
    ranks = similarities.argsort(dim=1).argsort(dim=1).float() + 1  # (K, N); ties do not happen
    positives = shown.sum(dim=0).float()  # (W,)
    negatives = len(shown) - positives
    won = ranks @ shown.float() - positives * (positives + 1) / 2  # (K, W)
    return won / (positives * negatives).clamp(min=1)
