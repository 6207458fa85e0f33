"""Decoded labels of test trajectories, which results hold, and what follows from them without training.

A network that sees nothing of the future names a skill after it has begun, so that its boundaries are late by about as
many timesteps everywhere.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import cast

import numpy as np
import numpy.typing as npt

from experiments.segmentation.evaluation import FRAME_ACCURACY
from experiments.segmentation.packed import PACKED, PACKED_DECODED, unpack
from experiments.workbench import claims
from experiments.workbench.results import ArmResult, Sample
from freerein import metrics
from freerein.data.labels import moved

Labels = npt.NDArray[np.int64]

_MOST = 15
"""Most timesteps that labels are moved by."""


@dataclass(frozen=True, eq=False)
class Decoded:
    """Decoded labels of the networks of a row, and the true ones.

    Attributes:
        networks: By network and test trajectory, int64 (T,).
        truth: By test trajectory, int64 (T,).
    """

    networks: Sequence[Sequence[Labels]]
    truth: Sequence[Labels]

    @classmethod
    def of(cls, arms: Sequence[ArmResult], truth: ArmResult) -> "Decoded | None":
        """Returns the labels of a row's arms, given that of the truth; None where none of them has any."""
        networks = [_unpacked(arm, PACKED_DECODED) for arm in arms if f"test.{PACKED_DECODED}" in arm.shown]
        return cls(networks, _unpacked(truth, PACKED)) if networks else None

    def samples(self, change: Callable[[Labels], Labels] = lambda labels: labels) -> list[Sample]:
        """Returns the frame accuracy of each network's labels, changed."""
        pairs = (zip(labels, self.truth, strict=True) for labels in self.networks)
        return [Sample.of_flags(change(ours) == theirs for ours, theirs in each) for each in pairs]

    def boundary_error(self) -> tuple[float, float] | None:
        """Returns mean and standard deviation of how late skills begin, in timesteps, over boundaries and networks.

        None where no skill of a boundary begins anywhere.
        """
        pairs = [pair for labels in self.networks for pair in zip(labels, self.truth, strict=True)]
        errors = [error for pair in pairs for error in boundary_errors(*pair)]
        return (float(np.mean(errors)), float(np.std(errors))) if errors else None

    def best_delay(self) -> int:
        """Returns how many timesteps earlier labels are most accurate: by true labels, for the development world."""
        values = [claims.mean(self.moved_samples(timesteps)) for timesteps in range(_MOST + 1)]
        return int(np.argmax(values))

    def moved_samples(self, timesteps: int) -> list[Sample]:
        """Returns the frame accuracy of each network's labels, so many timesteps earlier."""
        return self.samples(partial(moved, timesteps=timesteps))


def _unpacked(arm: ArmResult, name: str) -> list[Labels]:
    lengths = [int(count) for count in arm.samples[f"test.{FRAME_ACCURACY}"].counts]
    return unpack(cast(str, arm.shown[f"test.{name}"]), lengths)


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
