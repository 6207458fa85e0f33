"""Intrinsic Curiosity Module (Pathak et al. 2017): a reward for transitions that a forward model predicts badly.

    phi(s), phi(s')  -- inverse model -->  a         so phi keeps what actions influence
    phi(s), a        -- forward model -->  phi(s')   its error is the reward

It sees frames and executed actions only. Two departures from the paper:

- phi is trained by the inverse model alone, as in Burda et al. (2019): with the forward error it collapsed.
- The forward model predicts the change of phi, so that static parts of a scene need not be learned.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn
from torch.nn import functional

from freerein.config import bounded
from freerein.learning import weights
from freerein.learning.actor_critic.networks import ActorCriticSpec
from freerein.learning.encoders import ENCODERS
from freerein.learning.optimiser import optimiser_step
from freerein.learning.train_state import BatchSampler, FitLoopState, TrainState
from freerein_orchestrator.rl.errors import IterationRejected
from freerein_orchestrator.rl.rollout import RolloutBuffer

FORWARD_BATCH = 1024
"""Frames that are encoded at once where nothing is learned."""


@dataclass(frozen=True)
class ICMConfig:
    """Hyperparameters of the curiosity module; defaults of `forward_weight` and `scale` are the paper's.

    Attributes:
        forward_weight: Weight of the forward loss (beta); the inverse loss has the rest.
        scale: Scale of the reward (eta).
        epochs: Passes over each rollout.
        batch_size: Most transitions per minibatch.
        lr: Learning rate of Adam.
        hidden_size: Units of the hidden layer of each model.
        seed: Seed of every random draw.
    """

    forward_weight: float = bounded(0.2, least=0.0, most=1.0)
    scale: float = bounded(0.01, least=1e-6, most=1e6)
    epochs: int = bounded(8, least=1, most=100)
    batch_size: int = bounded(64, least=2, most=65_536)
    lr: float = bounded(2e-3, least=1e-7, most=1.0)
    hidden_size: int = bounded(256, least=2, most=4096)
    seed: int = bounded(0, least=0, most=2**31 - 1)


@dataclass(frozen=True, eq=False)
class Transitions:
    """M environment steps.

    Attributes:
        observations: uint8 (M, H, W, C).
        actions: As executed, float32 (M, A) in [-1, 1] or int64 (M, 1).
        next_observations: uint8 (M, H, W, C); the final one where an episode ended.
    """

    observations: Tensor
    actions: Tensor
    next_observations: Tensor

    @classmethod
    def of(cls, rollout: RolloutBuffer) -> "Transitions":
        """Returns the T * N steps of a rollout, in order of time."""
        steps = (rollout.observations, rollout.executed_actions, rollout.next_observations)
        return cls(*(each.flatten(end_dim=1) for each in steps))

    def __len__(self) -> int:
        return len(self.actions)

    def map(self, function: Callable[[Tensor], Tensor]) -> "Transitions":
        """Returns the transitions with a function applied to each tensor."""
        return Transitions(**{each.name: function(getattr(self, each.name)) for each in fields(self)})

    def select(self, items: npt.NDArray[np.int64]) -> "Transitions":
        """Returns some of the transitions."""
        return self.map(lambda tensor: tensor[torch.from_numpy(items)])


class ICM(nn.Module):
    """Image features, an inverse model and a forward model.

    Args:
        spec: Frames and actions of the environments; `feature_size` image features.
        hidden_size: Units of the hidden layer of each model.
    """

    def __init__(self, spec: ActorCriticSpec, *, hidden_size: int) -> None:
        super().__init__()
        self._choices = spec.action_choices
        outputs = spec.action_choices or spec.action_size
        height, width, channels = spec.observation_shape
        self.image = ENCODERS[spec.encoder](height=height, width=width, channels=channels, features=spec.feature_size)
        self.inverse = _mlp(2 * spec.feature_size, hidden_size, outputs)
        self.change = _mlp(spec.feature_size + outputs, hidden_size, spec.feature_size)

    @torch.no_grad()
    def copy_calibration(self, image: nn.Module) -> None:
        """Copies the calibration of another encoder of the same frames."""
        for own, other in zip(self.image.buffers(), image.buffers(), strict=True):
            own.copy_(other)

    def forward(self, transitions: Transitions) -> tuple[Tensor, Tensor]:
        """Returns the errors of the inverse and of the forward model, float32 (M,) each.

        The inverse model's is the cross-entropy of discrete actions (eq. 3) or the squared error of continuous ones;
        the forward model's is half the squared error of the features (eq. 5).
        """
        images = torch.cat([transitions.observations, transitions.next_observations])
        before, after = self.image(images).chunk(2)  # (M, features) each
        predicted_action = self.inverse(torch.cat([before, after], dim=-1))
        encoded = functional.one_hot(transitions.actions[:, 0], self._choices).float() if self._choices else None
        actions = transitions.actions if encoded is None else encoded
        predicted_change = self.change(torch.cat([before.detach(), actions], dim=-1))
        error = (after - before).detach() - predicted_change
        return self._inverse_error(predicted_action, transitions.actions), 0.5 * error.square().sum(dim=-1)

    def _inverse_error(self, predicted: Tensor, actions: Tensor) -> Tensor:
        if self._choices:
            return functional.cross_entropy(predicted, actions[:, 0], reduction="none")
        return (predicted - actions).square().sum(dim=-1)


def init_icm(config: ICMConfig, spec: ActorCriticSpec, *, transitions: int, device: torch.device) -> FitLoopState[ICM]:
    """Returns an untrained module; calibrate it before use.

    Args:
        config: Hyperparameters.
        spec: Frames and actions.
        transitions: Transitions per rollout.
        device: Where it is trained.
    """
    generator = torch.Generator().manual_seed(config.seed)
    network = ICM(spec, hidden_size=config.hidden_size)
    weights.initialise(network, generator=generator)
    network = network.to(device)
    sampler = BatchSampler.start(transitions, rng=np.random.default_rng(config.seed))
    return FitLoopState(TrainState.with_adam(network, config.lr, generator=generator), sampler)


@torch.no_grad()
def intrinsic_rewards(network: ICM, transitions: Transitions, *, scale: float) -> Tensor:
    """Returns eta / 2 * |phi_hat(s') - phi(s')|^2 of each transition (eq. 6), float32 (M,), on the CPU."""
    device = next(network.parameters()).device
    parts = zip(*(getattr(transitions, each.name).split(FORWARD_BATCH) for each in fields(transitions)), strict=True)
    errors = [network(Transitions(*part).map(lambda tensor: tensor.to(device)))[1].cpu() for part in parts]
    return scale * torch.cat(errors)


def update_icm(
    learner: FitLoopState[ICM], transitions: Transitions, config: ICMConfig
) -> tuple[FitLoopState[ICM], dict[str, float]]:
    """Returns the module after one rollout's optimiser steps on eq. 7, and its mean losses. Changes it in place.

    Raises:
        IterationRejected: A weight is not finite.
    """
    state = learner.state
    device, losses = next(state.network.parameters()).device, list[Tensor]()
    size = min(config.batch_size, len(transitions))
    for _ in range(config.epochs * (len(transitions) // size)):
        batch = transitions.select(learner.sampler.next_batch(size)).map(lambda tensor: tensor.to(device))
        inverse, forward = (error.mean() for error in state.network(batch))
        loss = (1 - config.forward_weight) * inverse + config.forward_weight * forward
        state = optimiser_step(state, loss, lr=config.lr)
        losses.append(torch.stack([inverse, forward]).detach())
    if not all(parameter.isfinite().all() for parameter in state.network.parameters()):
        raise IterationRejected("Weights of the curiosity module must stay finite.", hint="Lower its learning rate.")
    means = torch.stack(losses).mean(dim=0).tolist()
    return replace(learner, state=state), dict(zip(("inverse_loss", "forward_loss"), means, strict=True))


def _mlp(inputs: int, hidden_size: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, hidden_size), nn.ReLU(), nn.Linear(hidden_size, outputs))
