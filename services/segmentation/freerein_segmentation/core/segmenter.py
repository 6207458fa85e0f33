"""`Segmenter`: labels trajectories with skills."""

import asyncio
from contextlib import aclosing
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import numpy.typing as npt

from freerein.errors import InvalidInput
from freerein.serving.call_timer import CallTimer
from freerein.serving.limits import Slots
from freerein.serving.model_cache import ModelCache
from freerein.types.common import ModelRef
from freerein.types.segmentation import ListSkillsRequest, ListSkillsResponse, SegmentRequest, SegmentResponse
from freerein_segmentation.core import decoding
from freerein_segmentation.core.inference import SegmentationBatcher, SkillModel, predict, predict_encoded
from freerein_segmentation.core.inputs import (
    check_length,
    check_one_form,
    check_options,
    checked_actions,
    read_timesteps,
)
from freerein_segmentation.core.video_decoding import VideoDecoding
from freerein_segmentation.model import Prediction


@dataclass(frozen=True, eq=False)
class Segmenter:
    """Answers `Segment` and `ListSkills`.

    Attributes:
        models: The models.
        batcher: Runs `run_batch` on the model's thread.
        videos: Decodes videos.
        decoded: Bytes of decoded images, which may be hundreds of times those received, of all calls that wait.
    """

    models: ModelCache[SkillModel]
    batcher: SegmentationBatcher
    videos: VideoDecoding
    decoded: Slots

    async def list_skills(self, request: ListSkillsRequest) -> ListSkillsResponse:
        """Returns the skills and the expected inputs of a model; raises as `ModelCache.resolve`."""
        return describe(*await self.models.resolve(request.model))

    async def segment(self, request: SegmentRequest) -> SegmentResponse:
        """Returns a label for every timestep of a trajectory.

        Raises:
            InvalidInput: An option, the frames or the actions are not what the model expects, or the video is corrupt.
            UnsupportedMedia: An image or the video is in an encoding that is not read.
            TooLarge: The trajectory is too long.
            Unimplemented: No decoder of video is installed.
            Overloaded: Too many videos are being decoded, or too many images wait.
            NotFound, FailedPrecondition: There is no such model, or no active one.
        """
        timer = CallTimer()
        check_options(
            request.smoothing,
            request.min_confidence,
            fps=request.fps,
            min_segment=request.min_segment,
            min_kept=request.min_kept,
        )
        ref, model = await self.models.resolve(request.model)
        time_s, fps = np.empty(0, np.float32), 0.0
        if request.video:
            fps = request.fps or model.fps
            prediction, time_s = await self._predict_video(ref, model, replace(request, fps=fps), timer)
        else:
            camera = model.camera
            with self.decoded.hold(len(request.images) * camera.height * camera.width * camera.channels):
                frames, actions = await timer.decode(read_timesteps(model, request))
                prediction = timer.output(await self.batcher.submit(partial(predict, model, frames, actions), key=ref))
        labels, confidence, segments = await asyncio.to_thread(
            decoding.decode,
            prediction.probabilities,
            skills=model.skills,
            smoothing=request.smoothing,
            min_segment=request.min_segment,
            min_confidence=request.min_confidence,
            min_kept=request.min_kept,
        )
        return SegmentResponse(
            labels, confidence, prediction.in_distribution, segments, model.skills, ref, timer.timing(), time_s, fps
        )

    async def _predict_video(
        self, ref: ModelRef, model: SkillModel, request: SegmentRequest, timer: CallTimer
    ) -> tuple[Prediction, npt.NDArray[np.float32]]:
        """Returns the prediction for the timesteps of a video, and their times, float32 (T,)."""
        check_one_form(request)
        actions = None if model.action is None else checked_actions(model.action, request.actions, None)
        parts, times, count = [], [np.empty(0, np.float32)], 0
        sampled = self.videos.frames(request.video, model.camera, resize=request.resize, fps=request.fps)
        async with aclosing(sampled) as chunks:
            while chunk := await timer.decode(anext(chunks, None)):
                at = slice(count, count + len(chunk.frames))
                count = at.stop
                check_length(count, field="video")
                did = None if actions is None else actions[at]
                if did is not None and len(did) < len(chunk.frames):
                    break
                done = await self.batcher.submit(partial(model.encode, chunk.frames, did), key=ref)
                parts.append(timer.output(done))
                times.append(chunk.time_s)
        if actions is not None and len(actions) != count:
            raise _unequal(len(actions), count, request.fps)
        done = await self.batcher.submit(partial(predict_encoded, model, parts), key=ref)
        return timer.output(done), np.concatenate(times)


def _unequal(actions: int, timesteps: int, fps: float) -> InvalidInput:
    least, rate = "at least " if timesteps > actions else "", f", {fps:g} per second" if fps else ""
    return InvalidInput(
        f"`actions` must have a row for each timestep of the video{rate}; got {actions} rows for {least}{timesteps} "
        "timesteps.",
        field="actions",
        hint="Send the executed action of each, at the rate that the model was trained on, or say another: `fps`.",
    )


def describe(ref: ModelRef, model: SkillModel) -> ListSkillsResponse:
    """Returns the skills and the expected inputs of a model."""
    return ListSkillsResponse(
        skills=model.skills,
        model=ref,
        height=model.camera.height,
        width=model.camera.width,
        channels=model.camera.channels,
        action_size=model.action.size if model.action else 0,
        action_choices=model.action.choices if model.action else 0,
        lag=model.lag,
        camera=model.camera.name,
        fps=model.fps,
    )
