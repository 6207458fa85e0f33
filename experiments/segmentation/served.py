"""A workbench network as a model that the segmentation service serves: weights, and a card with the arm's figures."""

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from experiments.segmentation.study import Study
from freerein.data import integer_fps
from freerein.learning.model_files import save_model
from freerein.learning.training_loop import FitResult
from freerein_segmentation.methods import METHODS
from freerein_segmentation.model import SegmentationNetwork
from freerein_segmentation.training import SegmentationLearner
from freerein_sim.worlds.tasks import tasks


def save(
    study: Study,
    learner: SegmentationLearner,
    fitted: FitResult[SegmentationNetwork],
    folder: Path,
    *,
    figures: Mapping[str, float],
    command: str,
) -> None:
    """Writes the model of an arm.

    Args:
        study: The arm's study.
        learner: What trained the network.
        fitted: The network.
        folder: Receives the model's files.
        figures: What the arm measured; those against true labels are for readers, and chose nothing.
        command: What trains it again.
    """
    learner.calibrate(fitted.network)
    card: dict[str, Any] = {
        "method": next(iter(METHODS.by_name)),
        "command": command,
        "task": study.world,
        "data": {
            "trajectories": len(learner.training),
            "fingerprint": learner.fingerprint,
            "fps": integer_fps(tasks()[study.world].spec.control_dt_s),
        },
        "config": asdict(learner.config),
        "figures": {**fitted.figures, **figures},
        "supervision": "the set of skills of each trajectory",
        "tag_average_precision": learner.tag_average_precision(fitted.network),
        "held_out": len(learner.validation),
        "warnings": [],
    }
    save_model(fitted.network, folder, card=card)
