"""Curiosity: a reward for what cannot be foreseen yet (Pathak et al. 2017, "ICM").

    phi(s), phi(s')  -- inverse model -->  a         so phi keeps what actions influence, and what tells their effects
    phi(s), a        -- forward model -->  phi(s')   its error is the reward

It sees frames and the actions that were executed, and nothing else. Two departures from the paper:

- phi learns from the inverse model alone, as in Burda et al. 2019. Where the forward error reached it too, phi became
  the same for all frames, and nothing surprised.
- The forward model tells by how much phi changes. What stays as it is, most of a scene, need not be learnt by heart.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn
from torch.nn import functional

from freerein.learning import weights
from freerein.learning.batch_sampler import BatchSampler
from freerein.learning.config import bounded
from freerein.learning.encoders import SpatialEncoder
from freerein.learning.optimiser import optimiser_step
from freerein.learning.train_state import FitLoopState, TrainState
from freerein_orchestrator.networks import ActorCriticSpec
from freerein_orchestrator.rejection import Rejected

_AT_ONCE = 1024  # transitions in one forward pass


@dataclass(frozen=True)
class CuriosityConfig:
    """What curiosity may choose; the defaults of `forward_weight` and `scale` are the paper's.

    Attributes:
        forward_weight: Of the forward model's loss (beta); the inverse model's has the rest.
        scale: Of the reward (eta).
        epochs: Times that each transition is learnt from.
        batch_size: Transitions per update, at most.
        lr: Of Adam.
        hidden: Units of the hidden layer of each model.
        seed: Of every random draw.
    """

    forward_weight: float = bounded(0.2, least=0.0, most=1.0)
    scale: float = bounded(0.01, least=1e-6, most=1e6)
    epochs: int = bounded(8, least=1, most=100)
    batch_size: int = bounded(64, least=2, most=65_536)
    lr: float = bounded(2e-3, least=1e-7, most=1.0)
    hidden: int = bounded(256, least=2, most=4096)
    seed: int = bounded(0, least=0, most=2**31 - 1)


@dataclass(frozen=True, eq=False)
class Transitions:
    """M steps of any environments.

    Attributes:
        before: What was seen before the action, uint8 (M, H, W, C).
        actions: As they were executed, float32 (M, A) in [-1, 1] or int64 (M, 1).
        after: What the action led to, uint8 (M, H, W, C): where it ended an episode, the last frame of that one.
    """

    before: Tensor
    actions: Tensor
    after: Tensor

    def __len__(self) -> int:
        return len(self.actions)

    def pick(self, items: npt.NDArray[np.int64]) -> "Transitions":
        """Returns some of the steps."""
        chosen = torch.from_numpy(items)
        return Transitions(**{each.name: getattr(self, each.name)[chosen] for each in fields(self)})

    def to(self, device: torch.device) -> "Transitions":
        """Returns the steps on a device."""
        return Transitions(**{each.name: getattr(self, each.name).to(device) for each in fields(self)})


class Curiosity(nn.Module):
    """Features of frames, and the two models that are learnt with them.

    Args:
        spec: What is seen, which must be frames, and done; `features` are as many as it says.
        hidden: Units of the hidden layer of each model.
    """

    def __init__(self, spec: ActorCriticSpec, *, hidden: int) -> None:
        super().__init__()
        outputs = spec.action_choices or spec.action_size
        self._choices = spec.action_choices
        self.image = SpatialEncoder(
            height=spec.height, width=spec.width, channels=spec.channels, features=spec.features
        )
        self.inverse = _two_layers(2 * spec.features, hidden, outputs)
        self.change = _two_layers(spec.features + outputs, hidden, spec.features)

    @torch.no_grad()
    def calibrate(self, image: SpatialEncoder) -> None:
        """Takes the mean image, and the deviation from it, of another encoder of the same frames."""
        self.image.mean_image.copy_(image.mean_image)
        self.image.pixel_std.copy_(image.pixel_std)

    def forward(self, transitions: Transitions) -> tuple[Tensor, Tensor]:
        """Returns, for each of M transitions, the errors of both models: float32 (M,) each.

        The inverse model's is the cross-entropy of a discrete action (eq. 3), or the squared error of a continuous one;
        the forward model's is half the squared error of the features (eq. 5).
        """
        before, after = self.image(torch.cat([transitions.before, transitions.after])).chunk(2)  # (M, features) each
        told = self.inverse(torch.cat([before, after], dim=-1))
        change = self.change(torch.cat([before.detach(), self._encoded(transitions.actions)], dim=-1))
        unforeseen = (after - before).detach() - change
        return self._inverse_errors(told, transitions.actions), 0.5 * unforeseen.square().sum(dim=-1)

    def _inverse_errors(self, told: Tensor, actions: Tensor) -> Tensor:
        if self._choices:
            return functional.cross_entropy(told, actions[:, 0], reduction="none")
        return (told - actions).square().sum(dim=-1)

    def _encoded(self, actions: Tensor) -> Tensor:
        """Returns actions as numbers: float32 (M, A), or (M, choices) with a single 1."""
        return functional.one_hot(actions[:, 0], self._choices).float() if self._choices else actions


def begin(
    config: CuriosityConfig, spec: ActorCriticSpec, *, transitions: int, device: torch.device
) -> FitLoopState[Curiosity]:
    """Returns curiosity that knows nothing yet; calibrate it before it is used.

    Args:
        config: What was chosen.
        spec: What is seen and done.
        transitions: How many are learnt from at a time.
        device: Where the networks are.
    """
    generator = torch.Generator().manual_seed(config.seed)
    network = Curiosity(spec, hidden=config.hidden)
    weights.initialise(network, generator=generator)
    network = network.to(device)
    optimiser = torch.optim.Adam(network.parameters(), config.lr, fused=True)
    sampler = BatchSampler.start(transitions, rng=np.random.default_rng(config.seed))
    return FitLoopState(TrainState(network, optimiser, generator), sampler)


@torch.no_grad()
def surprise(network: Curiosity, transitions: Transitions, *, scale: float) -> Tensor:
    """Returns the reward of each transition, eta / 2 * |phi_hat(s') - phi(s')|^2 (eq. 6): float32 (M,), on the CPU."""
    device = next(network.parameters()).device
    parts = zip(*(getattr(transitions, each.name).split(_AT_ONCE) for each in fields(transitions)), strict=True)
    errors = [network(Transitions(*part).to(device))[1].cpu() for part in parts]
    return scale * torch.cat(errors)


def learn(
    progress: FitLoopState[Curiosity], transitions: Transitions, config: CuriosityConfig
) -> tuple[FitLoopState[Curiosity], dict[str, float]]:
    """Returns curiosity after some updates that lower (1 - beta) * inverse + beta * forward errors (eq. 7).

    Args:
        progress: Before them; the networks are changed in place.
        transitions: As many as `begin` was told.
        config: What was chosen.

    Returns:
        Curiosity, and both errors' means over the updates.

    Raises:
        Rejected: A weight is not finite.
    """
    state, metrics = progress.state, list[Mapping[str, Tensor]]()
    device = next(state.network.parameters()).device
    size = min(config.batch_size, len(transitions))
    for _ in range(config.epochs * (len(transitions) // size)):
        inverse, forward = state.network(transitions.pick(progress.sampler.next_batch(size)).to(device))
        loss = (1 - config.forward_weight) * inverse.mean() + config.forward_weight * forward.mean()
        state = optimiser_step(state, loss, lr=config.lr)
        metrics.append({"inverse_error": inverse.detach().mean(), "forward_error": forward.detach().mean()})
    if not all(parameter.isfinite().all() for parameter in state.network.parameters()):
        raise Rejected("Curiosity's weights must stay finite; some are not.", hint="Lower its learning rate.")
    means = {name: torch.stack([each[name] for each in metrics]).mean().item() for name in metrics[0]}
    return replace(progress, state=state), means


def _two_layers(inputs: int, hidden: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, hidden), nn.ReLU(), nn.Linear(hidden, outputs))
