"""How late labels are.

A network that sees nothing of the future names a skill after it has begun, so that its boundaries are late by about as
many timesteps everywhere.
"""

import numpy as np
import numpy.typing as npt

from freerein import metrics

Labels = npt.NDArray[np.int64]

MOST = 15
"""Most timesteps that labels are moved by."""


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
