"""What a finished segmentation fit is worth: figures of its card, and accuracy on trajectories labelled by hand.

True labels are read here, beside the user, from the data directory; neither the fit nor the service opens them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from freerein import metrics
from freerein.cli.connection import SEGMENT_TIMEOUT_S
from freerein.clients import SegmentationClient
from freerein.data import Dataset, truth
from freerein.errors import FailedPrecondition
from freerein.types.learning import Fit
from freerein.types.segmentation import NO_SKILL, SegmentRequest

_UNKNOWN = -1


@dataclass(frozen=True)
class LabelledAccuracy:
    """Frame accuracy on trajectories labelled by hand, their tags being known to the fit.

    Attributes:
        trajectories: Their number.
        timesteps: Number of their labelled timesteps.
        frame_accuracy: Fraction of correctly labelled timesteps.
        random_cls_accuracy: That of guessing among the skills that occur in each.
    """

    trajectories: int
    timesteps: int
    frame_accuracy: float
    random_cls_accuracy: float


def card_figures(card: dict[str, Any]) -> dict[str, Any]:
    """Returns what a segmentation model's card says of its worth, on so many held-out trajectories; and warnings."""
    names = ("figures", "tag_average_precision", "held_out", "warnings")
    return {name: card[name] for name in names if name in card}


def labelled_trajectories(root: Path) -> list[int]:
    """Returns the indices of the trajectories that have true labels; empty where the dataset is not on this machine."""
    return truth.labelled(root)


async def labelled_accuracy(client: SegmentationClient, fit: Fit, root: Path, items: Sequence[int]) -> LabelledAccuracy:
    """Returns the accuracy of a fit's model on trajectories that have true labels.

    Raises:
        FailedPrecondition: The dataset's skills are no longer those of the model.
        ServiceError: The service cannot answer.
    """
    dataset = Dataset(root)
    camera = str(fit.config["cameras"][0])
    predicted, labels, random = list[npt.NDArray[np.int64]](), list[npt.NDArray[np.int64]](), list[float]()
    for index in items:
        trajectory = dataset[index]
        request = SegmentRequest(fit.model) if fit.model else SegmentRequest()
        filled = replace(request, frames=trajectory.frames[camera], actions=trajectory.actions)
        answer = await client.segment(filled, timeout_s=SEGMENT_TIMEOUT_S)
        names = np.array([_place(skill, dataset.spec.skills) for skill in answer.skills], np.int64)
        true = truth.labels(root, index)
        is_known = true != NO_SKILL
        predicted.append(names[answer.labels][is_known])
        labels.append(true[is_known])
        random.append(metrics.random_cls_accuracy(labels[-1]) * len(labels[-1]))
    joined = np.concatenate(labels)
    if np.all(np.concatenate(predicted) == _UNKNOWN):
        raise FailedPrecondition(
            "The model's skills must be among the dataset's; none is.", hint="Fit the dataset again: its tags changed."
        )
    return LabelledAccuracy(
        trajectories=len(items),
        timesteps=len(joined),
        frame_accuracy=metrics.frame_accuracy(np.concatenate(predicted), joined),
        random_cls_accuracy=float(np.sum(random) / len(joined)),
    )


def _place(skill: str, skills: Sequence[str]) -> int:
    return skills.index(skill) if skill in skills else _UNKNOWN
