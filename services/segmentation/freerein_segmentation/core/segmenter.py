"""`Segmenter`: labels trajectories with skills."""

import asyncio
from dataclasses import dataclass

from freerein.serving.call_timer import CallTimer
from freerein.serving.model_cache import ModelCache
from freerein.types.common import ModelRef
from freerein.types.segmentation import ListSkillsRequest, ListSkillsResponse, SegmentRequest, SegmentResponse
from freerein_segmentation.core import decoding
from freerein_segmentation.core.inference import SegmentationBatcher, SkillModel, WholeTrajectory
from freerein_segmentation.core.inputs import check_options, read_timesteps


@dataclass(frozen=True, eq=False)
class Segmenter:
    """Answers `Segment` and `ListSkills`.

    Attributes:
        models: The models.
        batcher: Runs `run_batch` on the model's thread.
        timeout_s: Longest time in its queue, in seconds.
    """

    models: ModelCache[SkillModel]
    batcher: SegmentationBatcher
    timeout_s: float

    async def list_skills(self, request: ListSkillsRequest) -> ListSkillsResponse:
        """Returns the skills and the expected inputs of a model; raises as `ModelCache.resolve`."""
        return describe(*await self.models.resolve(request.model))

    async def segment(self, request: SegmentRequest) -> SegmentResponse:
        """Returns a label for every timestep of a trajectory.

        Raises:
            InvalidInput: An option, the frames or the actions are not what the model expects.
            TooLarge: The trajectory is too long.
            NotFound, FailedPrecondition: There is no such model, or no active one.
        """
        timer = CallTimer()
        check_options(request.smoothing, min_segment=request.min_segment, min_kept=request.min_kept)
        ref, model = await self.models.resolve(request.model)
        frames, actions = await timer.decode(read_timesteps(model, request))
        work = self.batcher.submit(WholeTrajectory(model, frames, actions), key=ref, timeout_s=self.timeout_s)
        (prediction,) = await timer.infer(work)
        labels, confidence, segments = await asyncio.to_thread(
            decoding.decode,
            prediction.probabilities,
            skills=model.skills,
            smoothing=request.smoothing,
            min_segment=request.min_segment,
            min_kept=request.min_kept,
        )
        return SegmentResponse(
            labels, confidence, prediction.in_distribution, segments, model.skills, ref, timer.timing()
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
    )
