"""LRU cache of goal embeddings, bounded in bytes: a task scores thousands of frames against the same few texts."""

import threading
from collections import OrderedDict
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from freerein.types.common import ModelRef
from freerein_reward.core.models import RewardModel

_CHARACTER_BYTES = 8  # at most 4 in the text, and 4 in the UTF-8 form that it may come to hold
_ENTRY_BYTES = 600  # upper bound of Python's overhead per entry


@dataclass(frozen=True, eq=False)
class GoalEmbedding:
    """The embedding of a text.

    Attributes:
        vector: float32 (D,), of length 1 at most; not finite where the model overflowed.
        truncated: Whether the text was too long for the model and was truncated.
    """

    vector: npt.NDArray[np.float32]
    truncated: bool


class GoalCache:
    """Most recently used embeddings of any model, bounded in bytes. Any thread may read; the model's thread writes."""

    def __init__(self, limit_bytes: int) -> None:
        self._limit = limit_bytes
        self._entries: OrderedDict[tuple[ModelRef, str], GoalEmbedding] = OrderedDict()
        self._lock = threading.Lock()
        self.held_bytes = 0

    def __len__(self) -> int:
        """Returns the number of entries."""
        return len(self._entries)

    def find(self, ref: ModelRef, text: str) -> GoalEmbedding | None:
        """Returns the cached embedding of a text, or None."""
        with self._lock:
            if (ref, text) in self._entries:
                self._entries.move_to_end((ref, text))
            return self._entries.get((ref, text))

    def embed(self, ref: ModelRef, model: RewardModel, texts: Iterable[str]) -> dict[str, GoalEmbedding]:
        """Returns the embedding of each text; missing ones are computed alone, so that no other text changes a bit."""
        cached = {text: self.find(ref, text) for text in texts}
        found = {text: embedding for text, embedding in cached.items() if embedding is not None}
        for text in [text for text in cached if text not in found]:
            found[text] = _embed(model, text)
            self._add(ref, text, found[text])
        return found

    def _add(self, ref: ModelRef, text: str, embedding: GoalEmbedding) -> None:
        if not np.isfinite(embedding.vector).all():
            return
        with self._lock:
            self._entries[ref, text] = embedding
            self.held_bytes += _size(text, embedding)
            while self.held_bytes > self._limit:
                (_, oldest), dropped = self._entries.popitem(last=False)
                self.held_bytes -= _size(oldest, dropped)


def _embed(model: RewardModel, text: str) -> GoalEmbedding:
    vectors, truncated = model.embed_texts([text])
    if vectors.ndim != 2 or len(vectors) != 1 or truncated.shape != (1,):
        raise ValueError(f"the model returned {vectors.shape} and {truncated.shape} for one text")
    return GoalEmbedding(vectors[0].astype(np.float32), bool(truncated[0]))


def _size(text: str, embedding: GoalEmbedding) -> int:
    return _CHARACTER_BYTES * len(text) + embedding.vector.nbytes + _ENTRY_BYTES
