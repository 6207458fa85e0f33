"""Cost of three cameras to a reward model of criteria, beside one: scores of 32 moments for a goal text.

The models are untrained, of a fit's default size. Rewards are computed as the service's core does, without the network.
"""

from functools import partial

import numpy as np

from benchmarks.report import Ratio, Results
from benchmarks.timing import Effort, Workload, measure_rates, repeat_function
from benchmarks.untrained import grounding_spec, initialise
from freerein.criteria import CRITERIA
from freerein.criterion_text import Claim, CriterionCaption
from freerein.types.common import ModelRef
from freerein_reward.core import GoalCache, Inference
from freerein_reward.core.inference import ScoreItem
from freerein_reward.methods.criterion_captions.config import CriterionConfig
from freerein_reward.methods.criterion_captions.criterion_model import CriterionModel
from freerein_reward.methods.criterion_captions.keypoint_dataset import view_layout
from freerein_reward.methods.criterion_captions.method import network_spec
from freerein_reward.methods.criterion_captions.network import CriterionNetwork
from freerein_reward.model import DualEncoder, GradCamModel
from freerein_reward.training import synthetic_objects

_CAMERAS = ("front", "left", "tilt")
_PHRASES = ("a red block", "a green block", "a yellow block", "a blue block")
_GOAL = CriterionCaption(Claim.HOLDS, CRITERIA["left_of"], _PHRASES[:2])
_WIDTH, _MOMENTS, _CACHE_BYTES = 0.1, 32, 2**20


async def measure(effort: Effort) -> Results:
    """Returns how many times as long three cameras take as one."""
    side = synthetic_objects.IMAGE_SIZE
    frames = np.random.default_rng(0).integers(256, size=(3, _MOMENTS, side, side, 3), dtype=np.uint8)
    views, workloads, inference = dict(zip(_CAMERAS, frames, strict=True)), [], Inference(GoalCache(_CACHE_BYTES))
    for cameras in (_CAMERAS[:1], _CAMERAS):
        name = f"cameras-{len(cameras)}"
        item = ScoreItem(ModelRef(name), _model(cameras), (_GOAL.text, *_GOAL.rivals), views)
        workloads.append(Workload(name, repeat_function(partial(inference.run, [item])), _MOMENTS, "moments"))
    times = await measure_rates(workloads, effort)
    slower = times.speedup("cameras-1", over="cameras-3")
    return Results((Ratio("criteria.three_cameras_vs_one", slower, at_most=3.0),), {"criteria": times})


def _model(cameras: tuple[str, ...]) -> CriterionModel:
    """Returns an untrained model; with one camera, that is the front and the tilted view."""
    views = cameras if len(cameras) > 1 else (cameras[0], "", cameras[0])
    config = CriterionConfig(cameras=cameras, views=views, phrases=_PHRASES, object_widths=(_WIDTH,))
    layout = view_layout(cameras, views, config.object_widths, 1.0)
    network = CriterionNetwork(network_spec(GradCamModel(DualEncoder(grounding_spec())), config, layout))
    initialise(network)
    return CriterionModel(network)
