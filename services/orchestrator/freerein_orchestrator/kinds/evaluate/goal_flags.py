"""A policy's confidence that its goal is reached, measured against true states."""

from collections.abc import Sequence

import numpy as np

from freerein.metrics import auroc, expected_calibration_error
from freerein_orchestrator.envs.episodes import Episode
from freerein_orchestrator.kinds.evaluate.form import Figure


def judged(episode: Episode) -> tuple[list[float], list[bool]]:
    """Returns a policy's confidence in each frame that it saw after an action, and whether the task's goal held there.

    Frames after it has ended its goal do not count: it looks at none. Empty for a policy without such a confidence.
    """
    if episode.goal_confidence is None or episode.goal_index is None or not episode.goal_confidence.any():
        return [], []
    last = int(np.searchsorted(episode.goal_index, 1))  # the frame that ended it; goal_index never decreases
    confidence = episode.goal_confidence[1 : last + 1]
    holds = episode.rewards[: len(confidence)] > 0  # reward t is that of frame t + 1
    return confidence.tolist(), holds.tolist()


def flag_figures(confidence: Sequence[float], holds: Sequence[bool]) -> dict[str, Figure]:
    """Returns the calibration error of confidences, and their AUROC where goals held in some frames and not in others.

    There are no figures without frames.
    """
    said, true = np.array(confidence, np.float64), np.array(holds, np.bool_)
    if not len(said):
        return {}
    figures = {"goal_ece": Figure(expected_calibration_error(said, true), baseline=0.0)}
    if 0 < true.sum() < len(true):
        figures["goal_auroc"] = Figure(auroc(said, true), baseline=0.5)
    return figures
