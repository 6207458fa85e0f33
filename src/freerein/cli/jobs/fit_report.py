"""The report of a finished segmentation fit: figures of its card, and accuracy on trajectories labelled by hand.

True labels are read here, beside the user, from the data directory; neither the fit nor the service opens them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import typer

from freerein import metrics
from freerein.cli.connection import SEGMENT_TIMEOUT_S, call
from freerein.cli.jobs.display import check_succeeded
from freerein.cli.jobs.ids import short
from freerein.cli.output import print_json
from freerein.cli.settings import CliSettings
from freerein.cli.tables import show_table
from freerein.clients import FitClient, ModelClient, SegmentationClient
from freerein.data import Dataset, dataset_path, truth
from freerein.errors import FailedPrecondition
from freerein.types.learning import Fit, GetFitRequest, ListModelsRequest
from freerein.types.segmentation import NO_SKILL, SegmentRequest

_UNKNOWN = -1
_FIGURES = ("figures", "tag_average_precision", "held_out", "warnings")
"""Members of a card that are printed as JSON."""


@dataclass(frozen=True)
class LabelledAccuracy:
    """Frame accuracy on trajectories labelled by hand, their tags being known to the fit; and that of guessing.

    `random_cls_accuracy` is that of guessing among the skills that occur in each.
    """

    trajectories: int
    timesteps: int
    frame_accuracy: float
    random_cls_accuracy: float


def show(fit_id: str, *, as_json: bool) -> None:
    """Prints the figures of a segmentation fit; raises FailedPrecondition where it has not succeeded."""
    fit = call(FitClient, "segmentation", lambda client: client.get_fit(GetFitRequest(fit_id))).fit
    check_succeeded(f"fit {short(fit_id)}", fit)
    card, root = card_of("segmentation", fit), dataset_path(CliSettings().data_dir, fit.dataset)
    labelled = truth.labelled(root)  # empty where the dataset is not on this machine
    items = [index for index in labelled if np.any(truth.labels(root, index) != NO_SKILL)]
    accuracy = None
    if items:
        accuracy = call(SegmentationClient, "segmentation", lambda client: labelled_accuracy(client, fit, root, items))
    if as_json:
        figures = {name: card[name] for name in _FIGURES if name in card}
        print_json({"fit": fit_id, **figures, "labelled": asdict(accuracy) if accuracy else None})
    else:
        _show_table(card, accuracy)


def card_of(service: str, fit: Fit) -> dict[str, Any]:
    """Returns the card of the model that a fit made; empty without."""
    models = call(ModelClient, service, lambda client: client.list_models(ListModelsRequest())).models
    return next((dict(model.card) for model in models if model.ref == fit.model), {})


def show_warnings(card: Mapping[str, Any]) -> None:
    """Prints the warnings and notes of a model's card."""
    for line in (*(f"warning: {each}" for each in card.get("warnings", ())), *card.get("notes", ())):
        typer.echo(line)


def _show_table(card: Mapping[str, Any], accuracy: LabelledAccuracy | None) -> None:
    rows = [
        (f"tag average precision, {skill}", f"{each['average_precision']:.3f}", f"{each['chance']:.3f}")
        for skill, each in card.get("tag_average_precision", {}).items()
    ]
    mean = card.get("figures", {}).get("tag_average_precision")
    if mean is not None:
        rows.append((f"tag average precision, mean on {card.get('held_out')} held-out trajectories", f"{mean:.3f}", ""))
    if accuracy:
        name = f"frame accuracy, {accuracy.trajectories} labelled trajectories"
        rows.append((name, f"{accuracy.frame_accuracy:.3f}", f"{accuracy.random_cls_accuracy:.3f}"))
    show_table(("", "model", "chance"), rows)
    show_warnings(card)


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
