"""One update of the goal-conditioned networks, and their losses on held-out exploration."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freerein.learning import weights
from freerein.learning.optimiser import cosine_lr, optimiser_step
from freerein.learning.train_state import TrainState
from freerein_imitation.model import action_code
from freerein_imitation.model.goal_conditioned import GoalConditionedNetwork, GoalConditionedSpec
from freerein_imitation.model.recognizer import closeness
from freerein_imitation.objectives import action_cross_entropy, masked_mean, recognition, squared_error
from freerein_imitation.training.exploration import Exploration
from freerein_imitation.training.goal_conditioned.config import GoalConditionedConfig
from freerein_imitation.training.goal_conditioned.slices import Moments, Slices, draw_moments, draw_slices

State = TrainState[GoalConditionedNetwork]

_CALIBRATION_FRAMES = 2000
_EVALUATED_WINDOWS = 192


@dataclass(frozen=True, eq=False)
class Losses:
    """What eq. 3.4 and the recognizer's loss consist of, each float ().

    Attributes:
        action: Eq. 3.2, over all slices and timesteps.
        forward: Of what the forward model predicts of executed actions; 0 without one.
        consistency: Of what it predicts of the policy's actions; 0 without one.
        recognition: The recognizer's.
    """

    action: Tensor
    forward: Tensor
    consistency: Tensor
    recognition: Tensor


def init(
    config: GoalConditionedConfig,
    spec: GoalConditionedSpec,
    exploration: Exploration,
    *,
    generator: torch.Generator,
    device: torch.device,
) -> State:
    """Returns the state before the first update; the encoders' background is that of the exploration."""
    network = GoalConditionedNetwork(spec)
    weights.initialise(network, generator=generator)
    network.calibrate(torch.from_numpy(exploration.spread(_CALIBRATION_FRAMES)))
    network = network.to(device)
    return TrainState(network, torch.optim.Adam(network.parameters(), config.lr, fused=True), generator)


def update(
    state: State, exploration: Exploration, items: Sequence[int], *, config: GoalConditionedConfig
) -> tuple[State, dict[str, float]]:
    """Returns the state after one update on some trajectories, and its metrics."""
    rng = np.random.default_rng(torch.randint(2**62, (2,), generator=state.generator).tolist())
    parts = losses(state.network, *draw(exploration, items, rng, config=config, device=_device(state.network)))
    loss = parts.action + parts.forward + config.forward_consistency * parts.consistency + parts.recognition
    rate = cosine_lr(config.lr, state.step, warmup_steps=config.warmup_steps, steps=config.steps)
    metrics = {"train_loss": loss.item(), "action_loss": parts.action.item(), "goal_loss": parts.recognition.item()}
    return optimiser_step(state, loss, lr=rate), metrics


@torch.no_grad()
def evaluate(network: GoalConditionedNetwork, exploration: Exploration, *, config: GoalConditionedConfig) -> Losses:
    """Returns the mean losses on held-out trajectories, on the same slices and pairs every time."""
    rng, device = np.random.default_rng(config.seed), _device(network)
    items = windows(exploration, config)
    items = items[:: math.ceil(len(items) / _EVALUATED_WINDOWS)]
    parts = [
        losses(network, *draw(exploration, batch.tolist(), rng, config=config, device=device))
        for batch in np.array_split(items, math.ceil(len(items) / config.batch_size))
    ]
    return Losses(*(torch.stack([getattr(part, each.name) for part in parts]).mean() for each in fields(Losses)))


def windows(exploration: Exploration, config: GoalConditionedConfig) -> npt.NDArray[np.int64]:
    """Returns the trajectory of each window to draw in an epoch, int64 (n,): every timestep counts about alike."""
    counts = np.ceil(exploration.lengths() / config.longest_slice).astype(np.int64)
    return np.repeat(np.arange(len(counts)), counts)


def draw(
    exploration: Exploration,
    items: Sequence[int],
    rng: np.random.Generator,
    *,
    config: GoalConditionedConfig,
    device: torch.device,
) -> tuple[Slices, Moments, GoalConditionedConfig]:
    """Returns slices and moments of some trajectories, as `losses` takes them."""
    slices = draw_slices(exploration, items, rng, bounds=config.bounds, device=device)
    moments = draw_moments(exploration, items, rng, close_steps=config.close_steps, device=device)
    return slices, moments, config


def losses(network: GoalConditionedNetwork, slices: Slices, moments: Moments, config: GoalConditionedConfig) -> Losses:
    """Returns what an update makes small."""
    features = network.policy.image(slices.frames)  # (N, D)
    at, mask = slices.timesteps, slices.mask  # (S, L)
    executed = action_code.encode(slices.actions[at], choices=network.spec.action_choices)  # (S, L, A, categories)
    scores, _ = network.policy(features[at], features[slices.goals], slices.previous[at])  # (S, L, A, categories)
    forward = consistency = features.new_zeros(())
    if network.forward_model is not None:
        known = features.detach()  # phi is learned by action prediction alone: else it could shrink until f is right
        seen, after = known[at], known[at + 1]  # (S, L, D)
        forward = masked_mean(squared_error(network.forward_model(seen, executed), after), mask)
        consistency = masked_mean(squared_error(network.forward_model(seen, scores.softmax(dim=-1)), after), mask)
    action = masked_mean(action_cross_entropy(scores, executed), mask)
    return Losses(action, forward, consistency, _recognition(network, moments, config))


def _recognition(network: GoalConditionedNetwork, moments: Moments, config: GoalConditionedConfig) -> Tensor:
    embedded = network.recognizer(moments.frames)  # (N, embedding)
    scores = closeness(embedded[:, None], embedded)  # (N, N)
    return recognition(scores, *moments.pairs(close_steps=config.close_steps, far_steps=config.far_steps))


def _device(network: GoalConditionedNetwork) -> torch.device:
    return next(network.parameters()).device
