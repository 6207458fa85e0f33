"""How late labels are, without true ones: as late as they must be moved for their skills to explain actions best.

A network that sees nothing of the future names a skill after it has begun, so that its boundaries are late by about as
many timesteps everywhere. Of labels that are moved k timesteps earlier, an action model of each skill is fitted to
training trajectories, on the network's features, and judged on held-out ones.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freerein import metrics
from freerein.learning.trajectories import Trajectories
from freerein_segmentation.model import SegmentationNetwork
from freerein_segmentation.training import fit_action_model

Labels = npt.NDArray[np.int64]

MOST = 15
"""Most timesteps that labels are moved by."""

_TRAJECTORIES = 200


def moved(labels: Labels, timesteps: int) -> Labels:
    """Returns labels (T,) so many timesteps earlier; the last skill lasts until the end."""
    return labels[np.minimum(np.arange(len(labels)) + timesteps, len(labels) - 1)]


def boundary_errors(predicted: Labels, truth: Labels) -> list[int]:
    """Returns by how many timesteps the skills of labels (T,) begin late, for each boundary of the true ones.

    It is that of the nearest beginning of the boundary's skill; a boundary whose skill never begins is left out.
    """
    starts, errors = metrics.run_starts(predicted)[1:], []
    for boundary in metrics.run_starts(truth)[1:]:
        of_skill = starts[predicted[starts] == truth[boundary]] - boundary
        if len(of_skill):
            errors.append(int(of_skill[np.abs(of_skill).argmin()]))
    return errors


def action_losses(
    network: SegmentationNetwork,
    training: Trajectories,
    training_labels: Sequence[Labels],
    validation: Trajectories,
    validation_labels: Sequence[Labels],
) -> list[float]:
    """Returns the held-out negative log-likelihood of actions, in nats per timestep, by how far labels are moved.

    The first value is of labels as they are, the last of labels `MOST` timesteps earlier; labels are int64 (T,) per
    trajectory.
    """
    seen, done = _encoded(network, training, len(training_labels))
    held_out, expected = _encoded(network, validation, len(validation_labels))
    losses = []
    for timesteps in range(MOST + 1):
        generator = torch.Generator().manual_seed(0)
        labels, others = (
            torch.from_numpy(np.concatenate([moved(each, timesteps) for each in part[:_TRAJECTORIES]])).to(seen.device)
            for part in (training_labels, validation_labels)
        )
        model = fit_action_model(seen, done, labels, spec=network.spec, generator=generator)
        losses.append(round(-model(held_out, expected).gather(1, others[:, None]).mean().item(), 4))
    return losses


@torch.no_grad()
def _encoded(network: SegmentationNetwork, seen: Trajectories, count: int) -> tuple[Tensor, Tensor]:
    """Returns features (N, D) and scaled actions (N, A) of the first trajectories."""
    device, items = network.head.weight.device, range(min(count, _TRAJECTORIES))
    features = [
        network.image({name: torch.from_numpy(np.array(each[item])).to(device) for name, each in seen.frames.items()})
        for item in items
    ]
    actions = torch.from_numpy(np.concatenate([seen.actions[item] for item in items])).to(device)
    return torch.cat(features), network.spec.scaled(actions)
