"""Embeddings of goal texts, kept: a task asks about the same few texts for thousands of frames."""

import sys
import threading
from collections import OrderedDict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from freerein.types.common import ModelRef
from freerein_reward.core.models import RewardModel

_TEXTS_AT_ONCE = 128
_ENTRY_BYTES = 500  # what Python needs around an embedding and its text, with some to spare


@dataclass(frozen=True, eq=False)
class GoalEmbedding:
    """A text as a model sees it.

    Attributes:
        vector: float32 (D,), of length 1; not finite where the model overflowed.
        truncated: Whether the text was too long for the model and was cut.
    """

    vector: npt.NDArray[np.float32]
    truncated: bool


class GoalCache:
    """The embeddings asked for last, of any model. Any thread may look for one; the model's thread adds them.

    Args:
        limit_bytes: How much memory it may take, texts and all.
    """

    def __init__(self, limit_bytes: int) -> None:
        self._limit = limit_bytes
        self._kept: OrderedDict[tuple[ModelRef, str], GoalEmbedding] = OrderedDict()
        self._lock = threading.Lock()
        self.held_bytes = 0

    def __len__(self) -> int:
        """Returns how many embeddings are kept."""
        return len(self._kept)

    def find(self, ref: ModelRef, text: str) -> GoalEmbedding | None:
        """Returns the embedding of a text where it is kept."""
        with self._lock:
            if (ref, text) in self._kept:
                self._kept.move_to_end((ref, text))
            return self._kept.get((ref, text))

    def embed(self, ref: ModelRef, model: RewardModel, texts: Iterable[str]) -> dict[str, GoalEmbedding]:
        """Returns the embedding of each text; those not kept are computed together.

        Args:
            ref: The model's name and version: another version embeds anew.
            model: The model.
            texts: Of any number; repeated ones count once.
        """
        looked_for = {text: self.find(ref, text) for text in texts}
        found = {text: embedding for text, embedding in looked_for.items() if embedding is not None}
        missing = [text for text in looked_for if text not in found]
        for start in range(0, len(missing), _TEXTS_AT_ONCE):
            for text, embedding in _embed(model, missing[start : start + _TEXTS_AT_ONCE]):
                found[text] = embedding
                self._keep(ref, text, embedding)
        return found

    def _keep(self, ref: ModelRef, text: str, embedding: GoalEmbedding) -> None:
        if not np.isfinite(embedding.vector).all():
            return
        with self._lock:
            self._kept[ref, text] = embedding
            self.held_bytes += _size(text, embedding)
            while self.held_bytes > self._limit:
                (_, oldest), dropped = self._kept.popitem(last=False)
                self.held_bytes -= _size(oldest, dropped)


def _embed(model: RewardModel, texts: Sequence[str]) -> Iterator[tuple[str, GoalEmbedding]]:
    vectors, truncated = model.embed_texts(texts)
    if vectors.ndim != 2 or len(vectors) != len(texts) or truncated.shape != (len(texts),):
        raise ValueError(f"the model answered {vectors.shape} and {truncated.shape} for {len(texts)} texts")
    for text, vector, cut in zip(texts, vectors, truncated, strict=True):
        yield text, GoalEmbedding(vector.astype(np.float32, copy=True), bool(cut))  # a view would keep the whole batch


def _size(text: str, embedding: GoalEmbedding) -> int:
    return sys.getsizeof(text) + embedding.vector.nbytes + _ENTRY_BYTES
