"""A dual encoder of criteria: what a caption says of two or three things, and what images show of them.

The embedding of images keeps the cells of each camera's feature map. That of a text has the embeddings of its nouns and
of what it says: a criterion that holds or fails, or that not all nouns are shown. Nouns are found in the cells, and
their distances in all cameras are embedded by an MLP. The similarity is a cosine.
"""

from collections.abc import Sequence
from itertools import combinations

import torch
from torch import Tensor, nn
from torch.nn import functional

from freerein.criteria import CRITERIA
from freerein.criterion_text import Claim, CriterionCaption, CriterionGrammar
from freerein.learning.encoders.clip import ClipFeatureMaps
from freerein.learning.image_statistics import image_statistics, statistics_sizes
from freerein.learning.in_distribution import InDistribution
from freerein.types.common import Camera
from freerein_reward.methods.criterion_captions.locator import Located, Locator
from freerein_reward.methods.criterion_captions.spec import CriterionSpec
from freerein_reward.model import ClipTextEncoder, Temperature, Tokenizer

MAX_NOUNS = 3
_PAIRS = tuple(combinations(range(MAX_NOUNS), 2))

_RANGE = 2.0
"""Distance up to which distances are resolved well, in object widths; criteria have their limits within it."""

STATEMENTS: tuple[tuple[Claim, str], ...] = (
    *((claim, name) for claim in (Claim.HOLDS, Claim.FAILS) for name in CRITERIA),
    (Claim.MISSING, ""),
)
"""Claims of captions, in the order of their embeddings."""


class CriterionNetwork(nn.Module):
    """The network of a model of criteria."""

    def __init__(self, spec: CriterionSpec) -> None:
        super().__init__()
        self.spec = spec
        self.grammar = CriterionGrammar(spec.phrases, spec.seen, spec.other_phrases)
        self.tokenizer = Tokenizer(spec.vocabulary)
        self.text = ClipTextEncoder(spec.texts, tokens=self.tokenizer.size).requires_grad_(False)
        self.image = ClipFeatureMaps(spec.width, spec.depth)
        self.cells = nn.Linear(self.image.channels, spec.phrase_dim, bias=False)
        self.locator = Locator(spec.phrase_dim)
        inputs, hidden = (2 * len(_PAIRS) + MAX_NOUNS) * len(spec.cameras) + 1, spec.hidden_size
        layers = (nn.Linear(inputs, hidden), nn.ReLU(), nn.Linear(hidden, hidden), nn.ReLU())
        self.mlp = nn.Sequential(*layers, nn.Linear(hidden, spec.embedding_dim))
        self.statements = nn.Embedding(len(STATEMENTS), spec.embedding_dim)
        self.temperature = Temperature()
        self.units = torch.tensor(spec.units).view(-1, 2)  # (V, 2)
        size = spec.image_size
        views = [Camera(name, size, size, 3) for name in spec.cameras]
        self.in_distribution = InDistribution(*statistics_sizes(views, colours=True))

    def embed_cells(self, views: Tensor) -> Tensor:
        """Returns the cells, float32 (N, V, h, w, D), of V camera views, uint8 (N, V, H, W, 3)."""
        maps = self.image.feature_maps(views.flatten(end_dim=1))  # (N * V, C, h, w)
        cells: Tensor = self.cells(maps.permute(0, 2, 3, 1)).unflatten(0, views.shape[:2])
        return cells

    def embed_phrases(self, phrases: Sequence[str]) -> Tensor:
        """Returns unit embeddings of noun phrases, float32 (K, D)."""
        ids = torch.from_numpy(self.tokenizer(phrases).ids).to(self.device)
        return functional.normalize(self.text(ids), dim=1)

    def locate(self, cells: Tensor, phrases: Tensor) -> Located:
        """Returns where phrases (K, D) are in the cells of each camera, (N, V, h, w, D): tensors (N, V, K, ...)."""
        found = self.locator(cells.flatten(end_dim=1), phrases)
        return Located(*(each.reshape(*cells.shape[:2], *each.shape[1:]) for each in found))

    def embed_keypoints(self, keypoints: Tensor, presence: Tensor, tuples: Tensor) -> Tensor:
        """Returns unit embeddings of what images show of tuples of phrases, float32 (N, T, E).

        Args:
            keypoints: float32 (N, V, K, 2), as fractions.
            presence: float32 (N, V, K).
            tuples: Numbers of the phrases, int64 (T, `MAX_NOUNS`); -1 in the last place of a pair.
        """
        is_noun = (tuples >= 0).float()  # (T, nouns)
        at, shown = keypoints[:, :, tuples], presence[:, :, tuples] * is_noun  # (N, V, T, nouns, 2), (N, V, T, nouns)
        first, second = (list(each) for each in zip(*_PAIRS, strict=True))
        apart = (at[..., first, :] - at[..., second, :]) / self.units[:, None, None].to(at.device)
        apart = (apart / _RANGE).tanh() * (shown[..., first] * shown[..., second])[..., None]  # (N, V, T, pairs, 2)
        by_camera = torch.cat([apart.flatten(start_dim=3), shown], dim=3)  # (N, V, T, pairs * 2 + nouns)
        by_tuple = by_camera.transpose(1, 2).flatten(start_dim=2)  # (N, T, ...)
        count = is_noun[:, -1:].expand(
            len(keypoints), -1, 1
        )  # distinguishes a pair from a triple without its last noun
        return functional.normalize(self.mlp(torch.cat([by_tuple, count], dim=2)), dim=2)

    def embed_statements(self) -> Tensor:
        """Returns the unit embedding of each of `STATEMENTS`, float32 (statements, E)."""
        return functional.normalize(self.statements.weight, dim=1)

    def embed_captions(self, captions: Sequence[CriterionCaption | None]) -> Tensor:
        """Returns the embeddings of captions, float32 (K, `MAX_NOUNS` * D + E), of length 1; 0 for none.

        A noun that a pair has not is 0.
        """
        size = MAX_NOUNS * self.spec.phrase_dim
        embeddings = torch.zeros(len(captions), size + self.spec.embedding_dim, device=self.device)
        for row, caption in zip(embeddings, captions, strict=True):
            if caption is not None:
                nouns = self.embed_phrases(caption.nouns).flatten()
                row[: len(nouns)] = nouns
                row[size:] = self.embed_statements()[statement_number(caption)]
                row.div_((1 + len(caption.nouns)) ** 0.5)
        return embeddings

    def similarities(self, cells: Tensor, texts: Tensor) -> Tensor:
        """Returns cosine similarities, float32 (N, K), of cells (N, V, h, w, D) and texts as of `embed_captions`."""
        phrases, said = torch.split(texts, [MAX_NOUNS * self.spec.phrase_dim, self.spec.embedding_dim], dim=1)
        nouns = phrases.reshape(len(texts), MAX_NOUNS, -1)  # (K, nouns, D)
        is_noun = nouns.abs().amax(dim=2) > 0  # (K, nouns)
        found = self.locate(cells, functional.normalize(nouns.flatten(end_dim=1), dim=1))
        numbers = torch.arange(is_noun.numel(), device=texts.device).view(is_noun.shape)
        seen = self.embed_keypoints(found.keypoints, found.presence, numbers.where(is_noun, -1))  # (N, K, E)
        return torch.einsum("nke,ke->nk", seen, functional.normalize(said, dim=1))

    def distance(self, views: Tensor) -> Tensor:
        """Returns how far views, uint8 (N, V, H, W, 3), are from the fit's: float32 (N,)."""
        return self.in_distribution.distance(self.statistics(views))

    def statistics(self, views: Tensor) -> Tensor:
        """Returns the in-distribution score's inputs, float32 (N, D), of views uint8 (N, V, H, W, 3)."""
        return image_statistics({str(each): view for each, view in enumerate(views.unbind(dim=1))}, colours=True)

    @property
    def device(self) -> torch.device:
        """Device of the parameters."""
        return self.cells.weight.device


def statement_number(caption: CriterionCaption) -> int:
    """Returns the place in `STATEMENTS` of what a caption says."""
    return STATEMENTS.index((caption.claim, caption.criterion.name if caption.criterion else ""))
