"""The learner of the segmentation network."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freerein.learning import weights
from freerein.learning.optimiser import fit_step
from freerein.learning.train_state import TrainState
from freerein.learning.trajectories import sample_frames
from freerein.types.common import ActionSpec
from freerein_segmentation.model import ModelSpec, SegmentationNetwork
from freerein_segmentation.objectives import OBJECTIVES
from freerein_segmentation.training.config import SegmentationConfig
from freerein_segmentation.training.demonstrations import Demonstrations, TrajectoryBatch, gather

State = TrainState[SegmentationNetwork]

_NORMALISATION_FRAMES = 2000


def network_spec(
    config: SegmentationConfig, *, frame: tuple[int, int, int], action: ActionSpec, skills: tuple[str, ...]
) -> ModelSpec:
    """Returns the architecture for frames of shape H, W, C and skills in the order of their labels.

    Raises:
        InvalidInput: Frames, actions or skills are out of bounds.
    """
    height, width, channels = frame
    return ModelSpec(
        skills=skills,
        camera=config.camera,
        height=height,
        width=width,
        channels=channels,
        action_size=action.size if config.use_actions else 0,
        action_choices=action.choices if config.use_actions else 0,
        stride=config.stride,
        context=config.context,
        features=config.features,
        hidden_size=config.hidden_size,
    )


@dataclass(frozen=True, eq=False)
class SegmentationLearner:
    """A `freerein.learning.fit.Learner` of a segmentation network."""

    config: SegmentationConfig
    spec: ModelSpec
    training: Demonstrations
    validation: Demonstrations
    fingerprint: str
    device: torch.device

    @property
    def size(self) -> int:
        """Number of training trajectories."""
        return len(self.training)

    def init(self, generator: torch.Generator) -> State:
        """Returns the initial state; the encoder is normalised by the training frames."""
        network = SegmentationNetwork(self.spec)
        weights.initialise(network, generator=generator)
        frames = sample_frames(self.training.frames, _NORMALISATION_FRAMES)
        network.image.fit_normalisation(torch.from_numpy(frames))
        return TrainState.with_adam(network.to(self.device), self.config.lr, generator=generator)

    def update(self, state: State, items: npt.NDArray[np.int64]) -> tuple[State, dict[str, float]]:
        """Returns the state after one optimiser step on some trajectories, and its `train_loss`."""
        phases = torch.randint(self.spec.stride, (len(items),), generator=state.generator).tolist()
        batch = gather(self.training, items.tolist(), phases, spec=self.spec, device=self.device)
        return fit_step(state, self._losses(state.network, batch).mean(), self.config)

    @torch.no_grad()
    def evaluate(self, state: State) -> float:
        """Returns the mean loss of the validation trajectories' tags."""
        losses = []
        for start in range(0, len(self.validation), self.config.batch_size):
            items = range(start, min(start + self.config.batch_size, len(self.validation)))
            batch = gather(self.validation, items, [0] * len(items), spec=self.spec, device=self.device)
            losses.append(self._losses(state.network, batch))
        return torch.cat(losses).mean().item()

    def _losses(self, network: SegmentationNetwork, batch: TrajectoryBatch) -> Tensor:
        scores, mask = network(batch.frames, batch.actions, batch.lengths)
        return OBJECTIVES[self.config.objective](scores, mask, batch.tags)
