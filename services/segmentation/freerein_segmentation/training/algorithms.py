"""Algorithms that learn skills from tags, by the name of a fit's final objective: the stages of the fit, in order.

A new algorithm is a function that returns its stages, and a line in `ALGORITHMS`.
"""

from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, TypeAlias

from freerein_segmentation.objectives import OBJECTIVES
from freerein_segmentation.objectives.set_likelihood import set_likelihood
from freerein_segmentation.training.self_training import self_training

if TYPE_CHECKING:
    from freerein_segmentation.training.learner import SegmentationLearner, TagStage

Algorithm: TypeAlias = Callable[["SegmentationLearner"], tuple["TagStage", ...]]


def objective_alone(learner: "SegmentationLearner") -> tuple["TagStage", ...]:
    """Returns one stage, of the objective."""
    config = learner.config
    return (learner.stage("objective", config.steps, OBJECTIVES[config.objective], context=config.context),)


def objective_then_set_likelihood(learner: "SegmentationLearner") -> tuple["TagStage", ...]:
    """Returns a stage of the objective, which finds where skills are, and one of the likelihood of the sets.

    The objective, such as `lse_per_timestep`, is lowest where all tags have equal shares of a trajectory; the set
    likelihood leaves shares free, and moves the boundaries.
    """
    first, config = learner.before_final(), learner.config
    return first, learner.stage(
        "set_likelihood",
        config.steps - first.steps,
        set_likelihood,
        context=config.context,
        begin=partial(learner.carry_confidence, context=first.context),
    )


ALGORITHMS: Mapping[str, Algorithm] = MappingProxyType(
    {
        "none": objective_alone,
        "set_likelihood": objective_then_set_likelihood,
        "self_training": self_training,
    }
)
