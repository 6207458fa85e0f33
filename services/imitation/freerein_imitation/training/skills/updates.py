"""One update of the skills, and their losses on held-out demonstrations."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from freerein.learning.optimiser import cosine_lr, optimiser_step
from freerein.learning.train_state import TrainState
from freerein_imitation.model import action_code
from freerein_imitation.model.codebook import moved
from freerein_imitation.model.skills import SkillsNetwork
from freerein_imitation.objectives import absolute_error, action_cross_entropy, ending, masked_mean
from freerein_imitation.training.skills.config import SkillsConfig
from freerein_imitation.training.skills.segments import Batch, Segment, Segments, gather

State = TrainState[SkillsNetwork]

END_THRESHOLD = 0.5
"""From which probability on a skill has ended: the end head is trained with as much weight on ends as on the rest."""

_LEAST_LEFT = 5


@dataclass(frozen=True, eq=False)
class Losses:
    """What is made small, each float ().

    Attributes:
        action: How far the actions are from the executed ones, over all timesteps of segments.
        end: The end head's.
    """

    action: Tensor
    end: Tensor


def update(
    state: State, segments: Segments, items: Sequence[int], *, config: SkillsConfig
) -> tuple[State, dict[str, float]]:
    """Returns the state after one update on some segments, and its metrics."""
    rng = np.random.default_rng(torch.randint(2**62, (2,), generator=state.generator).tolist())
    chosen = [segments.items[item] for item in items]
    starts = [_enter(item, rng, config) for item in chosen]
    batch = gather(segments, chosen, starts, after=config.end_steps, device=_device(state.network))
    shift = config.shift * torch.tensor(rng.uniform(-1, 1, len(items)), dtype=torch.float32)
    parts = losses(state.network, replace(batch, places=moved(batch.places, shift.to(batch.places.device))))
    loss = parts.action + config.end_weight * parts.end
    rate = cosine_lr(config.lr, state.step, warmup_steps=config.warmup_steps, steps=config.steps)
    metrics = {"train_loss": loss.item(), "action_loss": parts.action.item(), "end_loss": parts.end.item()}
    return optimiser_step(state, loss, lr=rate), metrics


@torch.no_grad()
def evaluate(network: SkillsNetwork, segments: Segments, *, config: SkillsConfig) -> Losses:
    """Returns the losses on held-out segments, each entered where its labels say that it begins."""
    starts = [item.start for item in segments.items]
    return losses(network, gather(segments, segments.items, starts, after=config.end_steps, device=_device(network)))


def losses(network: SkillsNetwork, batch: Batch) -> Losses:
    """Returns what an update makes small."""
    spec = network.spec
    skill = functional.one_hot(batch.skills, len(spec.skills)).float()  # (B, skills)
    predicted, end, _ = network(batch.places, skill, batch.previous)
    if spec.action_choices:
        error = action_cross_entropy(predicted, action_code.encode(batch.actions, choices=spec.action_choices))
    else:
        error = absolute_error(predicted, batch.actions)  # (B, T)
    return Losses(masked_mean(error, batch.inside), ending(end, batch.ends, batch.inside & ~batch.ends))


def _enter(item: Segment, rng: np.random.Generator, config: SkillsConfig) -> int:
    """Returns where to enter a segment: near where it begins, for nobody knows exactly, or anywhere in it."""
    latest = max(item.start, item.stop - _LEAST_LEFT)
    if rng.random() < config.late_start_share:
        return int(rng.integers(item.start, latest, endpoint=True))
    jitter = int(rng.integers(-config.start_jitter, config.start_jitter, endpoint=True))
    return min(max(0, item.start + jitter), latest)


def _device(network: SkillsNetwork) -> torch.device:
    return network.end.weight.device
