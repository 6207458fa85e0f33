"""Reward models of the criteria of table 4.1 on the scattered blocks, judged by the five relations of the other models.

The relation that a model of criteria tells of two blocks is `on top of` or `below` where it rewards that goal, `apart
from` where "not close to" fits better than "close to", and else the better one of the two sides.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from experiments.robustness import scenes, unfamiliar
from experiments.robustness.draw import Drawn, dataset_path, open_or_draw
from experiments.robustness.fits import fit_once
from experiments.robustness.reward_model import EPSILON, PHRASES, TRAINING, grounding_version, open_grounding
from experiments.robustness.scenes import Judged
from experiments.robustness.worlds import CAMERA
from experiments.workbench.results import Outcome, Sample
from freerein.criteria import CRITERIA
from freerein.criterion_text import Claim, CriterionCaption
from freerein.relations import SpatialRelation
from freerein_reward.methods.criterion_captions.config import CriterionConfig
from freerein_reward.methods.criterion_captions.criterion_model import CriterionModel
from freerein_reward.methods.criterion_captions.keypoint_dataset import KeypointDataset, find_keypoints, view_layout
from freerein_reward.methods.criterion_captions.losses import CriterionLearner
from freerein_reward.methods.criterion_captions.method import METHOD as CRITERION_CAPTIONS
from freerein_reward.methods.criterion_captions.method import network_spec
from freerein_reward.methods.relation_captions.caption_dataset import ordered_pairs

METHOD = "criteria"

_GOALS = ("on_top_of", "below", "close_to", "left_of", "right_of")
_ASPECT = 1.0


def fit_config(*, seed: int) -> CriterionConfig:
    """Returns the service's configuration of a fit; in the plane of `blocks` one camera is two views."""
    return CriterionConfig.from_mapping(
        {
            "phrases": list(PHRASES),
            "cameras": [CAMERA],
            "views": [CAMERA, "", CAMERA],
            "object_widths": [EPSILON],
            "seed": seed,
        }
    )


def fit_model(config: CriterionConfig, work: Path, on_progress: Callable[[], None]) -> CriterionModel | None:
    """Returns the fitted model; None when the fit was stopped."""
    data = dataset_path(TRAINING, work).name

    def make_learner() -> CriterionLearner:
        grounding, drawn = open_grounding(), open_or_draw(TRAINING, work)
        layout = view_layout(config.cameras, config.views, config.object_widths, _ASPECT)
        frames = (drawn.seen["frames"],)
        moments = KeypointDataset(frames, *find_keypoints(frames, grounding, config, layout), layout)
        training, validation = moments.split(
            drawn.seen["lengths"], fraction=config.validation_fraction, seed=config.seed
        )
        spec, version = network_spec(grounding, config, layout), grounding_version()
        return CriterionLearner(
            config, spec, training, validation, grounding, version, f"{data} {version}", torch.device("cpu")
        )

    folder = fit_once(config, [data, grounding_version()], make_learner, work=work, on_progress=on_progress)
    return None if folder is None else CRITERION_CAPTIONS.load(folder, "cpu")


def evaluate(model: CriterionModel, work: Path) -> Outcome:
    """Returns accuracies and rewards of absent blocks by condition, those with distractors among them."""
    samples: dict[str, Sample] = {}
    for (condition, blocks), spec in unfamiliar.scene_specs().items():
        drawn = open_or_draw(spec, work)
        scored = scenes.score(judge(model, drawn), scenes.truth_of(drawn), drawn.seen["lengths"])
        samples |= {f"{condition}.{blocks}.{name}": sample for name, sample in scored}
    return Outcome({}, samples)


def judge(model: CriterionModel, drawn: Drawn) -> Judged:
    """Returns the relation that a model tells of each ordered pair, and whether it rewards any goal of the two."""
    pairs = [(PHRASES[first], PHRASES[second]) for first, second in ordered_pairs(len(PHRASES))]
    images = model.embed_images({CAMERA: drawn.seen["frames"]}).vectors
    judged = [_judge_pair(model, images, pair) for pair in pairs]
    relation, is_rewarded = (np.stack(each, axis=1) for each in zip(*judged, strict=True))
    return Judged(relation, is_rewarded)


def _judge_pair(
    model: CriterionModel, images: npt.NDArray[np.float32], pair: tuple[str, str]
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.bool_]]:
    """Returns the relation of a pair in images, int64 (M,), and whether any goal of the two is rewarded, bool (M,)."""
    goals = {name: CriterionCaption(Claim.HOLDS, CRITERIA[name], pair) for name in _GOALS}
    texts = list(dict.fromkeys(text for goal in goals.values() for text in (goal.text, *goal.rivals)))
    similarities = model.similarities(images, model.embed_texts(texts)[0])  # (M, texts)
    of = dict(zip(texts, similarities.T, strict=True))
    rewarded = {
        name: of[goal.text] > np.max([of[each] for each in goal.rivals], axis=0) for name, goal in goals.items()
    }
    is_apart = of[CriterionCaption(Claim.FAILS, CRITERIA["close_to"], pair).text] > of[goals["close_to"].text]
    is_left = of[goals["left_of"].text] > of[goals["right_of"].text]
    relation = np.select(
        [rewarded["on_top_of"], rewarded["below"], is_apart, is_left],
        [SpatialRelation.ON_TOP_OF, SpatialRelation.BELOW, SpatialRelation.APART_FROM, SpatialRelation.LEFT_OF],
        SpatialRelation.RIGHT_OF,
    )
    return relation.astype(np.int64), np.any(list(rewarded.values()), axis=0)
