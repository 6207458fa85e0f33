"""`GroundingCore`: locates noun phrases in images, and captions images with spatial relations."""

import asyncio
from collections.abc import Awaitable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import permutations

import numpy as np
import numpy.typing as npt
import PIL.Image

from freerein.errors import InvalidInput, must_be
from freerein.goal_text import Grammar
from freerein.relations import SpatialRelation, caption
from freerein.serving.batcher import BatchResult
from freerein.serving.call_timer import CallTimer
from freerein.serving.model_cache import ModelCache
from freerein.types.common import ModelRef
from freerein.types.reward import (
    DescribeRequest,
    DescribeResponse,
    Description,
    Grounding,
    GroundRequest,
    GroundResponse,
    UnknownPhrase,
)
from freerein_reward.core import inputs
from freerein_reward.core.inference import GroundItem, InferenceBatcher
from freerein_reward.core.models import GroundingModel, RewardModel, wrong_kind
from freerein_reward.model import GROUNDING, KNOWN, PhraseLocations
from freerein_reward.model.phrase_relations import NO_CAPTION, pairwise_relations

DEFAULT_EPSILON = 0.1
MAX_EPSILON = 0.5
_MIN_PRESENCE = 0.5
_IMAGES_AT_ONCE = 16


@dataclass(frozen=True, eq=False)
class GroundingCore:
    """Core of the RPCs `Ground` and `Describe`."""

    models: ModelCache[RewardModel | GroundingModel]
    batcher: InferenceBatcher

    async def ground(self, request: GroundRequest) -> GroundResponse:
        """Returns the location of each phrase in an image.

        Raises:
            InvalidInput: A phrase or the image is invalid, or the model locates nothing.
            UnsupportedMedia: The image is not in the declared encoding.
            OutputNotFinite: The model overflowed.
            NotFound, FailedPrecondition: There is no such model, or no active one.
        """
        timer = CallTimer()
        inputs.check_phrases(request.phrases, least=1)
        ref, model = await self._resolve(request.model)
        decode = partial(inputs.decode_image, request.image, model.preprocess, phrases=len(request.phrases))
        image, size = await timer.decode(asyncio.to_thread(decode))
        found = timer.output(await self._submit(GroundItem(model, image, request.phrases)))
        groundings = await asyncio.to_thread(_groundings, found, request.phrases, size)
        unknown = await asyncio.to_thread(_unknown, model.grammar, request.phrases, found.known)
        return GroundResponse(groundings, ref, timer.timing(), *unknown)

    async def describe(self, request: DescribeRequest) -> DescribeResponse:
        """Returns captions of the spatial relations that images show (table 4.1).

        Raises InvalidInput when a phrase, an image or `epsilon` is invalid; otherwise as `ground`.
        """
        timer = CallTimer()
        _check_describe(request)
        epsilon = DEFAULT_EPSILON if request.epsilon is None else request.epsilon
        ref, model = await self._resolve(request.model)
        await timer.decode(asyncio.to_thread(inputs.check_pixels, request.images))
        descriptions: list[Description] = []
        known = np.ones(len(request.phrases), np.float32)
        frames = inputs.EncodedFrames(request.images, range(len(request.images)))
        for start in range(0, len(frames), _IMAGES_AT_ONCE):
            stop = min(start + _IMAGES_AT_ONCE, len(frames))
            decode = partial(inputs.shaped_inputs, frames, model.preprocess, start=start, stop=stop)
            images, aspects = await timer.decode(asyncio.to_thread(decode))
            found = timer.output(await self._submit(GroundItem(model, images, request.phrases)))
            descriptions += map(Description, captions(found, request.phrases, epsilon=epsilon, aspects=aspects))
            known = found.known  # alike in all parts
        unknown = await asyncio.to_thread(_unknown, model.grammar, request.phrases, known)
        return DescribeResponse(tuple(descriptions), ref, timer.timing(), *unknown)

    async def _resolve(self, ref: ModelRef) -> tuple[ModelRef, GroundingModel]:
        ref, model = await self.models.resolve(ModelRef(ref.name or GROUNDING, ref.version))
        if not isinstance(model, GroundingModel):
            raise wrong_kind(ref, got="reward", expected="grounding")
        return ref, model

    def _submit(self, item: GroundItem) -> Awaitable[BatchResult[PhraseLocations]]:
        """Locates phrases in a few images, in a batch of their own."""
        return self.batcher.submit(item, key=object())


def captions(
    found: PhraseLocations, phrases: Sequence[str], *, epsilon: float, aspects: npt.NDArray[np.float64]
) -> list[tuple[str, ...]]:
    """Returns for each image a caption of each ordered pair of phrases that it shows (table 4.1).

    `epsilon` is the object width as a fraction of the image width; `aspects`, (N,), are height over width.
    """
    y = found.y * aspects[:, None]  # in the unit of x, the width
    relations = pairwise_relations(found.x, y, found.presence >= _MIN_PRESENCE, epsilon=epsilon)  # (N, P, P)
    pairs = tuple(permutations(range(len(phrases)), 2))
    return [
        tuple(
            caption(phrases[first], SpatialRelation(of_image[first, second]), phrases[second])
            for first, second in pairs
            if of_image[first, second] != NO_CAPTION
        )
        for of_image in relations
    ]


def _unknown(
    grammar: Grammar, phrases: Sequence[str], known: npt.NDArray[np.float32]
) -> tuple[tuple[str, ...], tuple[UnknownPhrase, ...]]:
    """Returns the unknown words of all phrases, and the phrases that are not known, by the model's score (P,)."""
    unknown = [phrase for phrase, score in zip(phrases, known, strict=True) if score < KNOWN]
    return grammar.unknown_words(phrases), tuple(
        UnknownPhrase(each, grammar.unknown_words((each,))) for each in unknown
    )


def _groundings(found: PhraseLocations, phrases: Sequence[str], size: tuple[int, int]) -> tuple[Grounding, ...]:
    """Returns the locations in the first image, in pixels of that image; `size` is its height and width."""
    height, width = size
    return tuple(
        Grounding(
            phrase=phrase,
            heatmap=_resize(found.heatmaps[0, index], height=height, width=width),
            x=float(found.x[0, index]) * width,
            y=float(found.y[0, index]) * height,
            presence=float(found.presence[0, index]),
        )
        for index, phrase in enumerate(phrases)
    )


def _resize(heatmap: npt.NDArray[np.float32], *, height: int, width: int) -> npt.NDArray[np.float32]:
    scaled = PIL.Image.fromarray(heatmap).resize((width, height), PIL.Image.Resampling.BILINEAR)
    return np.clip(np.asarray(scaled, np.float32), 0.0, 1.0)


def _check_describe(request: DescribeRequest) -> None:
    inputs.check_phrases(request.phrases, least=2)
    if not request.images:
        raise InvalidInput("`images` must hold at least one image; got none.", field="images", hint="Send one.")
    if request.epsilon is not None and not 0.0 < request.epsilon <= MAX_EPSILON:
        hint = f"Leave it out for {DEFAULT_EPSILON:g}."
        raise must_be("epsilon", f"in (0, {MAX_EPSILON:g}]", f"{request.epsilon:g}", hint=hint)
