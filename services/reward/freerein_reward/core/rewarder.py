"""`Rewarder`: images and words in, rewards out."""

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
import numpy.typing as npt

from freerein.errors import InvalidInput
from freerein.serving.batcher import Batcher
from freerein.serving.model_cache import ModelCache
from freerein.types.common import ModelRef
from freerein.types.reward import (
    EmbedGoalRequest,
    EmbedGoalResponse,
    RewardRequest,
    RewardResponse,
)
from freerein_reward.core.frames import Footage, footage_of
from freerein_reward.core.goal_cache import GoalCache
from freerein_reward.core.inference import Item, Output, ScoreItem, Scores
from freerein_reward.core.models import GroundingModel, Loaded, Preprocess, RewardModel, wrong_kind
from freerein_reward.core.stopwatch import Stopwatch
from freerein_reward.core.texts import check_goal_text, check_rivals
from freerein_reward.relations import rivals

_FRAMES_AT_ONCE = 64


@dataclass(frozen=True, eq=False)
class _Ready:
    """A reward model that was asked for."""

    ref: ModelRef
    model: RewardModel
    preprocess: Preprocess


class Rewarder:
    """The core of the reward service.

    Args:
        models: The models, of both kinds.
        batcher: Runs `Inference` on the model's thread.
        goals: The embeddings that `Inference` keeps; one that is there needs no model.
        timeout_s: How long frames may wait for the model, in seconds.
    """

    def __init__(
        self, models: ModelCache[Loaded], batcher: Batcher[Item, Output], goals: GoalCache, *, timeout_s: float
    ) -> None:
        self._models = models
        self._batcher = batcher
        self._goals = goals
        self._timeout_s = timeout_s

    async def reward(self, request: RewardRequest) -> RewardResponse:
        """Returns the reward of every frame for showing what the goal text says (section 4.2).

        Raises:
            InvalidInput: A text or a frame is not as it must be, a camera is missing, the goal text has no rivals, or
                the model is a grounding model and the mode is not raw.
            TooLarge: There are too many frames.
            OutputNotFinite: The model overflowed.
            NotFound: There is no such model.
            FailedPrecondition: None is active.
        """
        watch = Stopwatch()
        check_goal_text(request.goal_text)
        check_rivals(request.rivals, request.goal_text)
        texts = _texts(request)
        ready = await self._reward_model(request.model, is_base_welcome=request.mode == "raw")
        footage = await watch.decoding(_footage(request, ready.model.cameras))
        parts = [
            await self._score(ready, texts, footage, start, watch) for start in range(0, footage.count, _FRAMES_AT_ONCE)
        ]
        similarities = np.concatenate([part.similarities for part in parts])  # (N, K)
        winners = _winners(similarities)
        return RewardResponse(
            rewards=(winners == 0).astype(np.float32) if request.mode == "binary" else similarities[:, 0],
            similarities=similarities[:, 0],
            winners=winners,
            texts=texts,
            truncated=any(goal.truncated for goal in parts[0].goals),
            unknown_words=ready.model.unknown_words(request.goal_text),
            model=ready.ref,
            timing=watch.timing(),
        )

    async def embed_goal(self, request: EmbedGoalRequest) -> EmbedGoalResponse:
        """Returns the embedding of a goal text.

        Raises:
            InvalidInput: The text is empty or too long, or the model is a grounding model.
            OutputNotFinite: The model overflowed.
            NotFound: There is no such model.
            FailedPrecondition: None is active.
        """
        watch = Stopwatch()
        check_goal_text(request.goal_text)
        ready = await self._reward_model(request.model)
        goal = self._goals.find(ready.ref, request.goal_text)
        if goal is None:
            (goal,) = (await self._infer(ScoreItem(ready.ref, ready.model, (request.goal_text,)), watch)).goals
        return EmbedGoalResponse(
            embedding=goal.vector,
            truncated=goal.truncated,
            unknown_words=ready.model.unknown_words(request.goal_text),
            model=ready.ref,
            timing=watch.timing(),
        )

    async def _reward_model(self, asked: ModelRef, *, is_base_welcome: bool = False) -> _Ready:
        """Returns a reward model, or a grounding model, whose raw similarities are the base reward (section 4.2)."""
        ref, loaded = await self._models.resolve(asked)
        is_base = isinstance(loaded.model, GroundingModel)
        if not isinstance(loaded.model, RewardModel) or (is_base and not is_base_welcome):
            raise wrong_kind(ref, is_a="grounding", wanted="reward")
        return _Ready(ref, loaded.model, loaded.preprocess)

    async def _score(
        self, ready: _Ready, texts: tuple[str, ...], footage: Footage, start: int, watch: Stopwatch
    ) -> Scores:
        """Holds a few frames against all texts; a lone frame shares its batch with those of other requests."""
        stop = min(start + _FRAMES_AT_ONCE, footage.count)
        views = await watch.decoding(asyncio.to_thread(footage.views, ready.preprocess, start=start, stop=stop))
        return await self._infer(ScoreItem(ready.ref, ready.model, texts, views), watch, is_alone=footage.count > 1)

    async def _infer(self, item: ScoreItem, watch: Stopwatch, *, is_alone: bool = False) -> Scores:
        key = object() if is_alone else item.ref
        return cast(Scores, await watch.inferring(self._batcher.submit(item, key=key, timeout_s=self._timeout_s)))


async def _footage(request: RewardRequest, cameras: Sequence[str]) -> Footage:
    """Returns the frames of a request; the headers of encoded images are read off the event loop."""
    return await asyncio.to_thread(footage_of, request, cameras) if request.images else footage_of(request, cameras)


def _texts(request: RewardRequest) -> tuple[str, ...]:
    """Returns the goal text and its rivals."""
    to_beat = request.rivals or rivals(request.goal_text)
    if not to_beat and request.mode == "binary":
        raise InvalidInput(
            "A binary reward needs rivals that the goal text can beat; none were given, and the goal text has no "
            "relation to make them from.",
            field="rivals",
            hint="Send `rivals`, such as what could be seen instead, or mode raw.",
        )
    return request.goal_text, *to_beat


def _winners(similarities: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
    """Returns for each frame the index of the text that fits best; the goal text must beat all rivals strictly."""
    if similarities.shape[1] == 1:
        return np.zeros(len(similarities), np.int64)
    rivals = similarities[:, 1:]
    return np.where(similarities[:, 0] > rivals.max(axis=1), 0, 1 + rivals.argmax(axis=1)).astype(np.int64)
