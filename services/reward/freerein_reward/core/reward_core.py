"""`RewardCore`: rewards of frames against a goal text, and embeddings of goal texts."""

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from freerein.errors import InvalidInput
from freerein.goal_text import GoalText, Grammar, ask_back, not_known
from freerein.serving.call_timer import CallTimer
from freerein.serving.model_cache import ModelCache
from freerein.types.common import ModelRef
from freerein.types.reward import (
    EmbedGoalRequest,
    EmbedGoalResponse,
    Mode,
    RewardHello,
    RewardRequest,
    RewardResponse,
)
from freerein_reward.core.goal_cache import GoalCache
from freerein_reward.core.inference import InferenceBatcher, ScoreItem, Scores
from freerein_reward.core.inputs import (
    FrameSequence,
    check_distinct,
    check_goal_text,
    check_rivals,
    model_inputs,
    request_frames,
)
from freerein_reward.core.models import GroundingModel, RewardModel, wrong_kind

_FRAMES_AT_ONCE = 64


@dataclass(frozen=True, eq=False)
class RewardCore:
    """Core of the RPCs `Reward` and `EmbedGoal`."""

    models: ModelCache[RewardModel | GroundingModel]
    batcher: InferenceBatcher
    goals: GoalCache

    async def reward(self, request: RewardRequest) -> RewardResponse:
        """Returns the reward of every frame for a goal text (section 4.2), read by the model's grammar.

        Raises:
            InvalidInput: A text or a frame is invalid, the model does not know a word of a rival, a camera is missing,
                a binary reward has no rivals, or the model is a grounding model and the mode is not raw.
            TooLarge: There are too many frames.
            OutputNotFinite: The model overflowed.
            NotFound, FailedPrecondition: There is no such model, or no active one.
        """
        timer = CallTimer()
        ref, model = await self.resolve(request)
        goal, texts, frames = await timer.decode(asyncio.to_thread(_decode, request, model))
        parts: list[Scores] = []
        count = len(frames[model.cameras[0]])
        for start in range(0, count, _FRAMES_AT_ONCE):
            stop = min(start + _FRAMES_AT_ONCE, count)
            views = await timer.decode(asyncio.to_thread(_views, frames, model, start, stop))
            key = ref if count == 1 else object()  # single frames share a batch with those of other requests
            parts.append(timer.output(await self.batcher.submit(ScoreItem(ref, model, texts, views), key=key)))
        similarities = np.concatenate([part.similarities for part in parts])  # (N, K)
        rewards, winners = judge(similarities, goal, request.mode)
        return RewardResponse(
            rewards=rewards,
            similarities=similarities[:, 0],
            winners=winners,
            texts=texts,
            truncated=any(text.truncated for text in parts[0].goals),
            in_distribution=np.concatenate([part.in_distribution for part in parts]) * (not goal.unknown),
            unknown=goal.unknown,
            model=ref,
            timing=timer.timing(),
            did_you_mean=goal.did_you_mean,
        )

    async def embed_goal(self, request: EmbedGoalRequest) -> EmbedGoalResponse:
        """Returns the embedding of a goal text, read by the model's grammar.

        Raises InvalidInput when the text has no words, is too long, or states nothing that the model tells; otherwise
        as `reward`.
        """
        timer = CallTimer()
        check_goal_text(request.goal_text)
        ref, model = await self._resolve(request.model, allow_grounding=False)
        goal = _read(request.goal_text, model.grammar, field="goal_text")
        found = self.goals.find(ref, goal.text)
        if found is None:
            (found,) = timer.output(await self.batcher.submit(ScoreItem(ref, model, (goal.text,)), key=ref)).goals
        return EmbedGoalResponse(
            embedding=found.vector,
            truncated=found.truncated,
            unknown=goal.unknown,
            model=ref,
            timing=timer.timing(),
            did_you_mean=goal.did_you_mean,
        )

    async def resolve(self, request: RewardRequest | RewardHello) -> tuple[ModelRef, RewardModel]:
        """Returns the model of a request, whose texts have words; raises as `reward`."""
        check_goal_text(request.goal_text)
        check_rivals(request.rivals)
        return await self._resolve(request.model, allow_grounding=request.mode == "raw")

    async def _resolve(self, ref: ModelRef, *, allow_grounding: bool) -> tuple[ModelRef, RewardModel]:
        """Returns a reward model; a grounding model's raw similarities are the base reward of section 4.2."""
        ref, model = await self.models.resolve(ref)
        if not isinstance(model, RewardModel) or not (model.grammar.states_goals or allow_grounding):
            raise wrong_kind(ref, got="grounding", expected="reward")
        return ref, model


def _decode(
    request: RewardRequest, model: RewardModel
) -> tuple[GoalText, tuple[str, ...], Mapping[str, FrameSequence]]:
    """Returns the goal text, all texts to compare, and the frames by camera."""
    goal, texts = read_texts(request, model.grammar)
    return goal, texts, request_frames(request, model.cameras)


def read_texts(request: RewardRequest | RewardHello, grammar: Grammar) -> tuple[GoalText, tuple[str, ...]]:
    """Returns the goal text as it was read, and all texts to compare, itself first; raises as `RewardCore.reward`."""
    goal = _read(request.goal_text, grammar, field="goal_text")
    return goal, (goal.text, *_rivals(request, goal, grammar))


def judge(
    similarities: npt.NDArray[np.float32], goal: GoalText, mode: Mode
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.int64]]:
    """Returns rewards, float32 (N,), and winners, int64 (N,), of N frames' similarities to K texts, (N, K)."""
    winners = _winners(similarities, is_known=not goal.unknown)
    return (winners == 0).astype(np.float32) if mode == "binary" else similarities[:, 0], winners


def _read(text: str, grammar: Grammar, *, field: str) -> GoalText:
    """Returns the reading of a text; raises InvalidInput for one that the model cannot be asked."""
    said = grammar.read(text)
    if said.problem:
        raise InvalidInput(
            f"`{field}` must state what the model tells. {said.problem}",
            field=field,
            hint=ask_back(said.did_you_mean, "Relate different things, such as: a red block on top of a blue block."),
        )
    return said


def _views(
    frames: Mapping[str, FrameSequence], model: RewardModel, start: int, stop: int
) -> dict[str, npt.NDArray[np.uint8]]:
    return {
        camera: model_inputs(sequence, model, camera, start=start, stop=stop) for camera, sequence in frames.items()
    }


def _rivals(request: RewardRequest | RewardHello, goal: GoalText, grammar: Grammar) -> tuple[str, ...]:
    rivals = tuple(_rival(each, grammar, field=f"rivals.{index}") for index, each in enumerate(request.rivals))
    check_distinct(rivals, goal.text)
    if not rivals and not goal.rivals and request.mode == "binary":
        raise _no_rivals(goal)
    return rivals or goal.rivals


def _rival(text: str, grammar: Grammar, *, field: str) -> str:
    """Returns a rival as it was read; a goal would beat one of words without meaning by chance."""
    said = _read(text, grammar, field=field)
    if said.unknown and grammar.states_goals:
        raise not_known(said.unknown, said.did_you_mean, field=field)
    return said.text


def _no_rivals(goal: GoalText) -> InvalidInput:
    if goal.unknown:
        return not_known(goal.unknown, goal.did_you_mean, field="goal_text")
    return InvalidInput(
        "A binary reward needs rivals; none were given, and the goal text states no relation of two different things "
        "to derive them from.",
        field="rivals",
        hint=ask_back(goal.did_you_mean, "Send `rivals`, descriptions of other outcomes, or use mode raw."),
    )


def _winners(similarities: npt.NDArray[np.float32], *, is_known: bool) -> npt.NDArray[np.int64]:
    """Returns the index of each frame's most similar text; the goal text, index 0, must beat all rivals strictly.

    A goal text with words that the model does not know beats none; where there are no rivals, it stays alone.
    """
    if similarities.shape[1] == 1:
        return np.zeros(len(similarities), np.int64)
    rivals = similarities[:, 1:]
    is_won = (similarities[:, 0] > rivals.max(axis=1)) & is_known
    return np.where(is_won, 0, 1 + rivals.argmax(axis=1)).astype(np.int64)
