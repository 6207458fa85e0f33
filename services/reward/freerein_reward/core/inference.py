"""Inference on the model's thread: similarities of frames and texts, and phrase grounding."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from freerein.errors import OutputNotFinite, ServiceError
from freerein.serving.batcher import Batcher
from freerein.types.common import ModelRef
from freerein_reward.core.goal_cache import GoalCache, GoalEmbedding
from freerein_reward.core.models import GroundingModel, RewardModel
from freerein_reward.model import ImageEmbeddings, PhraseLocations


@dataclass(frozen=True, eq=False)
class ScoreItem:
    """Frames by camera, uint8 (N, H, W, 3), to compare with one or more texts; without `views` texts alone."""

    ref: ModelRef
    model: RewardModel
    texts: tuple[str, ...]
    views: Mapping[str, npt.NDArray[np.uint8]] | None = None


@dataclass(frozen=True, eq=False)
class Scores:
    """Embeddings of K texts, their similarities to frames, float32 (N, K) in [-1, 1], and the answers' scores (N,)."""

    goals: tuple[GoalEmbedding, ...]
    similarities: npt.NDArray[np.float32]
    in_distribution: npt.NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class GroundItem:
    """Images, uint8 (N, H, W, 3), in which to locate phrases."""

    model: GroundingModel
    images: npt.NDArray[np.uint8]
    phrases: tuple[str, ...]


InferenceItem: TypeAlias = ScoreItem | GroundItem
InferenceOutput: TypeAlias = Scores | PhraseLocations
InferenceBatcher: TypeAlias = Batcher[InferenceItem, Any]


class Inference:
    """Runs models on the batcher's thread, with a cache of goal embeddings."""

    def __init__(self, goals: GoalCache) -> None:
        self._goals = goals

    def run(self, items: Sequence[InferenceItem]) -> list[InferenceOutput | ServiceError]:
        """Returns the outputs, or errors, of items of one kind and one model."""
        scored = [item for item in items if isinstance(item, ScoreItem)]
        return self._score(scored) if scored else [_ground(item) for item in items if isinstance(item, GroundItem)]

    def _score(self, items: Sequence[ScoreItem]) -> list[InferenceOutput | ServiceError]:
        ref, model = items[0].ref, items[0].model
        goals = self._goals.embed(ref, model, chain.from_iterable(item.texts for item in items))
        views = [item.views for item in items if item.views is not None]
        frames = iter(_embed_images(model, views))
        outputs: list[InferenceOutput | ServiceError] = []
        for item in items:
            embeddings = next(frames) if item.views is not None else None
            outputs.append(_scores(model, tuple(goals[text] for text in item.texts), embeddings))
        return outputs


def _embed_images(model: RewardModel, groups: Sequence[Mapping[str, npt.NDArray[np.uint8]]]) -> list[ImageEmbeddings]:
    """Returns the embeddings of each group of views, computed in one batch."""
    if not groups:
        return []
    counts = [len(next(iter(views.values()))) for views in groups]
    embeddings = model.embed_images({name: np.concatenate([views[name] for views in groups]) for name in groups[0]})
    vectors, distances = embeddings.vectors, embeddings.distances
    if vectors.ndim != 2 or not len(vectors) == len(distances) == sum(counts):
        raise ValueError(f"the model returned {vectors.shape} and {distances.shape} for {sum(counts)} frames")
    ends = np.cumsum(counts)[:-1]
    return [ImageEmbeddings(*each) for each in zip(np.split(vectors, ends), np.split(distances, ends), strict=True)]


def _scores(
    model: RewardModel, goals: tuple[GoalEmbedding, ...], frames: ImageEmbeddings | None
) -> Scores | OutputNotFinite:
    if not all(np.isfinite(goal.vector).all() for goal in goals):
        return _overflowed("goal_text", "Rephrase the text.")
    if frames is None:
        return Scores(goals, np.empty((0, len(goals)), np.float32), np.empty(0, np.float32))
    if not (np.isfinite(frames.vectors).all() and np.isfinite(frames.distances).all()):
        return _overflowed("frames", "Send frames like the training data.")
    texts = np.stack([goal.vector for goal in goals])  # (K, D)
    similarities = model.similarities(frames.vectors.astype(np.float32), texts)  # (N, K)
    return Scores(goals, similarities, model.in_distribution(frames.distances, similarities))


def _ground(item: GroundItem) -> InferenceOutput | ServiceError:
    found = item.model.locate(item.images, item.phrases)
    expected = (len(item.images), len(item.phrases))
    if not found.heatmaps.shape[:2] == found.x.shape == found.y.shape == found.presence.shape == expected:
        raise ValueError(f"the model returned {found.heatmaps.shape}, expected {expected}")
    if all(np.isfinite(part).all() for part in (found.heatmaps, found.x, found.y, found.presence)):
        return found
    return _overflowed("images", "Send images like the training data.")


def _overflowed(field: str, hint: str) -> OutputNotFinite:
    return OutputNotFinite("The model's output must be finite; it overflowed.", field=field, hint=hint)
