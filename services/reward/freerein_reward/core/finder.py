"""`Finder`: images and noun phrases in, places and captions out."""

import asyncio
from dataclasses import dataclass
from functools import partial
from typing import cast

import numpy as np
import numpy.typing as npt

from freerein.errors import InvalidInput
from freerein.serving.batcher import Batcher
from freerein.serving.model_cache import ModelCache
from freerein.types.common import ModelRef
from freerein.types.reward import (
    DescribeRequest,
    DescribeResponse,
    Description,
    GroundRequest,
    GroundResponse,
)
from freerein_reward.core.captions import captions
from freerein_reward.core.inference import GroundItem, Item, Output
from freerein_reward.core.models import GroundingModel, Loaded, Preprocess, wrong_kind
from freerein_reward.core.pictures import check_pixels, groundings_of, read_image, read_images
from freerein_reward.core.stopwatch import Stopwatch
from freerein_reward.core.texts import check_phrases
from freerein_reward.model import Grounds

GROUNDING = "grounding"
"""The model that answers where a request names none."""

MAX_GROUND_PHRASES = 64
MAX_DESCRIBE_PHRASES = 16
MAX_DESCRIBE_IMAGES = 256
DEFAULT_EPSILON = 0.1
MAX_EPSILON = 0.5
_IMAGES_AT_ONCE = 16


@dataclass(frozen=True, eq=False)
class _Ready:
    """A grounding model that was asked for."""

    ref: ModelRef
    model: GroundingModel
    preprocess: Preprocess


class Finder:
    """The part of the reward service's core that looks for things.

    Args:
        models: The models, of both kinds.
        batcher: Runs `Inference` on the model's thread.
        timeout_s: How long images may wait for the model, in seconds.
    """

    def __init__(self, models: ModelCache[Loaded], batcher: Batcher[Item, Output], *, timeout_s: float) -> None:
        self._models = models
        self._batcher = batcher
        self._timeout_s = timeout_s

    async def ground(self, request: GroundRequest) -> GroundResponse:
        """Returns where the things that phrases name are in an image.

        Raises:
            InvalidInput: A phrase or the image is not as it must be, or the model is a reward model.
            UnsupportedMedia: The image is not in the encoding it claims.
            OutputNotFinite: The model overflowed.
            NotFound: There is no such model.
            FailedPrecondition: None is active.
        """
        watch = Stopwatch()
        check_phrases(request.phrases, least=1, most=MAX_GROUND_PHRASES)
        ready = await self._grounding_model(request.model)
        read = partial(read_image, request.image, ready.preprocess, phrases=len(request.phrases))
        view, size = await watch.decoding(asyncio.to_thread(read))
        found = await self._look(ready, view, request.phrases, watch)
        groundings = await asyncio.to_thread(groundings_of, found, request.phrases, size)
        return GroundResponse(groundings, ready.ref, watch.timing())

    async def describe(self, request: DescribeRequest) -> DescribeResponse:
        """Returns what can be said of images: how the things that they show lie to one another (table 4.1).

        Raises:
            InvalidInput: A phrase, an image or `epsilon` is not as it must be, or the model is a reward model.
            UnsupportedMedia: An image is not in the encoding it claims.
            OutputNotFinite: The model overflowed.
            NotFound: There is no such model.
            FailedPrecondition: None is active.
        """
        watch = Stopwatch()
        _check_description(request)
        epsilon = DEFAULT_EPSILON if request.epsilon is None else request.epsilon
        ready = await self._grounding_model(request.model)
        await watch.decoding(asyncio.to_thread(check_pixels, request.images))
        descriptions: list[Description] = []
        for first in range(0, len(request.images), _IMAGES_AT_ONCE):
            some = request.images[first : first + _IMAGES_AT_ONCE]
            views = await watch.decoding(asyncio.to_thread(read_images, some, ready.preprocess, first=first))
            found = await self._look(ready, views, request.phrases, watch)
            descriptions += map(Description, captions(found, request.phrases, epsilon=epsilon))
        return DescribeResponse(tuple(descriptions), ready.ref, watch.timing())

    async def _grounding_model(self, asked: ModelRef) -> _Ready:
        ref, loaded = await self._models.resolve(ModelRef(asked.name or GROUNDING, asked.version))
        if not isinstance(loaded.model, GroundingModel):
            raise wrong_kind(ref, is_a="reward", wanted="grounding")
        return _Ready(ref, loaded.model, loaded.preprocess)

    async def _look(
        self, ready: _Ready, images: npt.NDArray[np.uint8], phrases: tuple[str, ...], watch: Stopwatch
    ) -> Grounds:
        """Looks for phrases in a few images, a batch of their own."""
        item = GroundItem(ready.model, images, phrases)
        return cast(Grounds, await watch.inferring(self._batcher.submit(item, key=object(), timeout_s=self._timeout_s)))


def _check_description(request: DescribeRequest) -> None:
    check_phrases(request.phrases, least=2, most=MAX_DESCRIBE_PHRASES)
    if not 1 <= len(request.images) <= MAX_DESCRIBE_IMAGES:
        raise InvalidInput(
            f"`images` must hold 1 to {MAX_DESCRIBE_IMAGES} images; got {len(request.images)}.",
            field="images",
            hint="Send them in parts.",
        )
    if request.epsilon is not None and not 0.0 < request.epsilon <= MAX_EPSILON:
        raise InvalidInput(
            f"`epsilon` must be in (0, {MAX_EPSILON:g}]; got {request.epsilon:g}.",
            field="epsilon",
            hint="Leave it out for 0.1.",
        )
