"""What runs on the model's thread: batches of frames against texts, and images in which phrases are looked for."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from freerein.errors import OutputNotFinite, ServiceError
from freerein.types.common import ModelRef
from freerein_reward.core.goal_cache import GoalCache, GoalEmbedding
from freerein_reward.core.models import GroundingModel, RewardModel
from freerein_reward.model import Grounds


@dataclass(frozen=True, eq=False)
class ScoreItem:
    """Frames to hold against texts, or texts alone.

    Attributes:
        ref: The model's name and version.
        model: The model.
        texts: At least one.
        views: By camera, uint8 (N, H, W, 3); none for texts alone.
    """

    ref: ModelRef
    model: RewardModel
    texts: tuple[str, ...]
    views: Mapping[str, npt.NDArray[np.uint8]] | None = None


@dataclass(frozen=True, eq=False)
class Scores:
    """What came of a `ScoreItem`.

    Attributes:
        goals: The embedding of each of K texts.
        similarities: float32 (N, K) in [-1, 1], the cosine of each frame and each text.
    """

    goals: tuple[GoalEmbedding, ...]
    similarities: npt.NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class GroundItem:
    """Images to look for phrases in.

    Attributes:
        model: The model.
        images: uint8 (N, H, W, 3).
        phrases: What to look for.
    """

    model: GroundingModel
    images: npt.NDArray[np.uint8]
    phrases: tuple[str, ...]


Item: TypeAlias = ScoreItem | GroundItem
Output: TypeAlias = Scores | Grounds


class Inference:
    """Runs models. It belongs to the batcher's thread.

    Args:
        goals: Where embeddings of texts are kept.
    """

    def __init__(self, goals: GoalCache) -> None:
        self._goals = goals

    def run(self, items: Sequence[Item]) -> list[Output | ServiceError]:
        """Returns the outputs of items of one kind and one model, or why the model has none."""
        scored = [item for item in items if isinstance(item, ScoreItem)]
        return self._score(scored) if scored else [_ground(item) for item in items if isinstance(item, GroundItem)]

    def _score(self, items: Sequence[ScoreItem]) -> list[Output | ServiceError]:
        ref, model = items[0].ref, items[0].model
        goals = self._goals.embed(ref, model, chain.from_iterable(item.texts for item in items))
        shown = [item.views for item in items if item.views is not None]
        frames = iter(_embed_images(model, shown))
        outputs: list[Output | ServiceError] = []
        for item in items:
            own = next(frames) if item.views is not None else None
            outputs.append(_scores(tuple(goals[text] for text in item.texts), own))
        return outputs


def _embed_images(
    model: RewardModel, shown: Sequence[Mapping[str, npt.NDArray[np.uint8]]]
) -> list[npt.NDArray[np.float32]]:
    """Returns the embeddings (N, D) of each of several groups of views, computed together."""
    if not shown:
        return []
    counts = [len(next(iter(views.values()))) for views in shown]
    embeddings = model.embed_images({camera: np.concatenate([views[camera] for views in shown]) for camera in shown[0]})
    if embeddings.ndim != 2 or len(embeddings) != sum(counts):
        raise ValueError(f"the model answered {embeddings.shape} for {sum(counts)} frames")
    return np.split(embeddings, np.cumsum(counts)[:-1])


def _scores(goals: tuple[GoalEmbedding, ...], frames: npt.NDArray[np.float32] | None) -> Scores | OutputNotFinite:
    if not all(np.isfinite(goal.vector).all() for goal in goals):
        return _overflowed("goal_text", "Say it in other words.")
    if frames is None:
        return Scores(goals, np.empty((0, len(goals)), np.float32))
    if not np.isfinite(frames).all():
        return _overflowed("frames", "Send frames like those that the model was trained on.")
    texts = np.stack([goal.vector for goal in goals])  # (K, D)
    return Scores(goals, np.clip(frames.astype(np.float32) @ texts.T, -1.0, 1.0))


def _ground(item: GroundItem) -> Output | ServiceError:
    found = item.model.ground(item.images, item.phrases)
    expected = (len(item.images), len(item.phrases))
    if not found.heatmaps.shape[:2] == found.x.shape == found.y.shape == found.presence.shape == expected:
        raise ValueError(f"the model answered {found.heatmaps.shape} where {expected} is due")
    if all(np.isfinite(part).all() for part in (found.heatmaps, found.x, found.y, found.presence)):
        return found
    return _overflowed("images", "Send images like those that the model was trained on.")


def _overflowed(field: str, hint: str) -> OutputNotFinite:
    return OutputNotFinite("The model's output must be finite; it overflowed on this request.", field=field, hint=hint)
