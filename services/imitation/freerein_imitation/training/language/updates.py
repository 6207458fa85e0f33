"""One update of the language policy, and its loss on held-out trajectories."""

import math

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freerein.learning.optimiser import cosine_lr, optimiser_step
from freerein.learning.train_state import TrainState
from freerein_imitation.model import action_code
from freerein_imitation.model.language import LanguageNetwork
from freerein_imitation.objectives import action_cross_entropy, action_squared_error
from freerein_imitation.training.language.config import LanguageConfig
from freerein_imitation.training.language.rollouts import Batch, Rollouts, random_crop

State = TrainState[LanguageNetwork]

_EVALUATED_TIMESTEPS = 1024
_AT_ONCE = 128


def update(
    state: State, rollouts: Rollouts, timesteps: npt.NDArray[np.int64], *, config: LanguageConfig
) -> tuple[State, dict[str, float]]:
    """Returns the state after one update on some timesteps, and its metrics."""
    batch = rollouts.gather(timesteps, device=_device(state.network))
    frames = batch.frames
    if config.smallest_crop < 1:
        frames = random_crop(frames, smallest=config.smallest_crop, generator=state.generator)
    loss = action_loss(state.network, Batch(frames, batch.codes, batch.actions)).mean()
    rate = cosine_lr(config.lr, state.step, warmup_steps=config.warmup_steps, steps=config.steps)
    return optimiser_step(state, loss, lr=rate), {"train_loss": loss.item()}


@torch.no_grad()
def evaluate(network: LanguageNetwork, rollouts: Rollouts) -> float:
    """Returns the mean loss over held-out timesteps, the same every time."""
    timesteps = np.arange(0, len(rollouts), math.ceil(len(rollouts) / _EVALUATED_TIMESTEPS))
    parts = np.split(timesteps, range(_AT_ONCE, len(timesteps), _AT_ONCE))
    losses = [action_loss(network, rollouts.gather(part, device=_device(network))) for part in parts]
    return torch.cat(losses).mean().item()


def action_loss(network: LanguageNetwork, batch: Batch) -> Tensor:
    """Returns how far each action is from the executed one, float (B,): the L2 loss of section 4.3."""
    predicted = network(batch.frames, batch.codes)
    choices = network.spec.action_choices
    if choices:
        return action_cross_entropy(predicted, action_code.encode(batch.actions, choices=choices))
    return action_squared_error(predicted, batch.actions)


def _device(network: LanguageNetwork) -> torch.device:
    return network.action.weight.device
