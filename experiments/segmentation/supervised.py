"""The supervised ceiling: the segmentation network, trained in the same loop from true labels.

Network, data and configuration are those of the weakly supervised learner; only the objective differs.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from experiments.segmentation import truth, weakly_supervised
from experiments.segmentation.dataset import DatasetSpec
from freerein.data.cache import StepCache
from freerein.learning.learner import Items, Learner, Losses
from freerein.learning.train_state import TrainState
from freerein.learning.trajectories import Trajectories
from freerein_segmentation.model import SegmentationNetwork
from freerein_segmentation.objectives.labels import NO_SKILL, label_cross_entropy
from freerein_segmentation.training import SegmentationConfig, SegmentationLearner, gather

State = TrainState[SegmentationNetwork]


def make_learner(config: SegmentationConfig, spec: DatasetSpec, folder: Path) -> "SupervisedLearner":
    """Returns the learner of true labels of the dataset in a folder; `config.objective` is not used."""
    weak = weakly_supervised.make_learner(config, spec, folder)
    return SupervisedLearner(
        config,
        weak.fingerprint,
        weak,
        truth.open_labels(folder, "train"),
        truth.open_labels(folder, "validation"),
    )


@dataclass(frozen=True, eq=False)
class SupervisedLearner(Learner[SegmentationNetwork]):
    """A learner whose loss is the cross-entropy of the true label of each timestep.

    Attributes:
        weak: The learner whose network, configuration and demonstrations it uses.
        labels: int64 (T,) per training trajectory.
        validation_labels: int64 (T,) per validation trajectory.
    """

    config: SegmentationConfig
    fingerprint: str
    weak: SegmentationLearner
    labels: StepCache[np.int64]
    validation_labels: StepCache[np.int64]

    @property
    def size(self) -> int:
        """Number of training trajectories."""
        return self.weak.size

    def init(self, generator: torch.Generator) -> State:
        """Returns the same initial state as the weakly supervised learner."""
        return self.weak.init(generator)

    def loss(self, state: State, items: Items) -> Losses:
        """Returns the loss of some trajectories."""
        phases = torch.randint(self.weak.spec.stride, (len(items),), generator=state.generator).tolist()
        losses = self._losses(state.network, self.weak.training, self.labels, items.tolist(), phases)
        return {"train_loss": losses.mean()}

    @torch.no_grad()
    def evaluate(self, state: State) -> float:
        """Returns the mean cross-entropy of the validation trajectories' labels."""
        count, size = len(self.weak.validation), self.config.batch_size
        batches = [list(range(start, min(start + size, count))) for start in range(0, count, size)]
        validation, labels = self.weak.validation, self.validation_labels
        losses = [self._losses(state.network, validation, labels, each, [0] * len(each)) for each in batches]
        return torch.cat(losses).mean().item()

    def _losses(
        self,
        network: SegmentationNetwork,
        seen: Trajectories,
        labels: StepCache[np.int64],
        items: list[int],
        phases: list[int],
    ) -> Tensor:
        """Returns the mean cross-entropy of each trajectory, float (B,), from its timesteps of a phase on."""
        spec = self.weak.spec
        batch = gather(seen, items, phases, spec=spec, device=self.weak.device)
        scores, mask = network(batch.frames, batch.actions, batch.lengths)  # (B, T, K), (B, T)
        strided = [
            labels[item][phase % len(labels[item]) :: spec.stride] for item, phase in zip(items, phases, strict=True)
        ]
        targets = torch.full_like(mask, NO_SKILL, dtype=torch.int64)  # (B, T)
        targets[mask] = torch.from_numpy(np.concatenate(strided)).to(self.weak.device)
        return label_cross_entropy(scores, targets)
