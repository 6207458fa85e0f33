"""One update, and the loss on held-out trajectories."""

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freerein.learning import weights
from freerein.learning.optimiser import cosine_lr, optimiser_step
from freerein.learning.train_state import TrainState
from freerein_segmentation.model import ModelSpec, SegmentationNetwork
from freerein_segmentation.objectives import OBJECTIVES, ObjectiveName
from freerein_segmentation.training.config import SegmentationConfig
from freerein_segmentation.training.demonstrations import Batch, Demonstrations, gather

State = TrainState[SegmentationNetwork]

_CALIBRATION_FRAMES = 2000


def init(
    config: SegmentationConfig,
    spec: ModelSpec,
    demonstrations: Demonstrations,
    *,
    generator: torch.Generator,
    device: torch.device,
) -> State:
    """Returns the state before the first update; the encoder's background is that of the demonstrations."""
    network = SegmentationNetwork(spec)
    weights.initialise(network, generator=generator)
    network.image.fit_normalisation(torch.from_numpy(_spread(demonstrations, _CALIBRATION_FRAMES)))
    network = network.to(device)
    return TrainState(network, torch.optim.Adam(network.parameters(), config.lr, fused=True), generator)


def update(state: State, batch: Batch, *, config: SegmentationConfig) -> tuple[State, dict[str, float]]:
    """Returns the state after one update, and its `train_loss`."""
    loss = _losses(state.network, batch, config.objective).mean()
    rate = cosine_lr(config.lr, state.step, warmup_steps=config.warmup_steps, steps=config.steps)
    return optimiser_step(state, loss, lr=rate), {"train_loss": loss.item()}


@torch.no_grad()
def evaluate(state: State, demonstrations: Demonstrations, *, config: SegmentationConfig) -> float:
    """Returns the mean loss on held-out trajectories: how well their tags are told, the only truth that may choose."""
    spec, device = state.network.spec, state.network.head.weight.device
    batches = [
        range(start, min(start + config.batch_size, len(demonstrations)))
        for start in range(0, len(demonstrations), config.batch_size)
    ]
    losses = [
        _losses(
            state.network, gather(demonstrations, batch, [0] * len(batch), spec=spec, device=device), config.objective
        )
        for batch in batches
    ]
    return torch.cat(losses).mean().item()


def _losses(network: SegmentationNetwork, batch: Batch, objective: ObjectiveName) -> Tensor:
    scores, mask = network(batch.frames, batch.actions, batch.lengths)
    return OBJECTIVES[objective](scores, mask, batch.tags)


def _spread(demonstrations: Demonstrations, count: int) -> npt.NDArray[np.uint8]:
    """Returns about `count` frames, spread evenly over trajectories and time."""
    total = sum(len(demonstrations.frames[item]) for item in range(len(demonstrations)))
    every = max(1, total // count)
    return np.concatenate([demonstrations.frames[item][item % every :: every] for item in range(len(demonstrations))])
