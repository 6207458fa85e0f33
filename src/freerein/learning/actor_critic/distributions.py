"""Action distributions that sample from a generator that is passed in."""

import math
from dataclasses import dataclass
from typing import TypeAlias

import torch
from torch import Tensor

_LOG_ROOT_TAU = 0.5 * math.log(2 * math.pi)


@dataclass(frozen=True, eq=False)
class Gaussian:
    """Continuous actions with independent components.

    Samples may lie outside [-1, 1]; they are clipped for execution only.

    Attributes:
        mean: float32 (..., A).
        log_std: float32 (A,).
    """

    mean: Tensor
    log_std: Tensor

    def sample(self, generator: torch.Generator) -> Tensor:
        """Returns samples, float32 (..., A); the generator is on the CPU."""
        noise = torch.randn(self.mean.shape, generator=generator).to(self.mean.device)
        return self.mean + self.log_std.exp() * noise

    def mode(self) -> Tensor:
        """Returns the most likely actions, float32 (..., A)."""
        return self.mean

    def log_prob(self, actions: Tensor) -> Tensor:
        """Returns the log density of actions float32 (..., A): float32 (...,)."""
        deviation = (actions - self.mean) * (-self.log_std).exp()
        return (-0.5 * deviation.square() - self.log_std - _LOG_ROOT_TAU).sum(dim=-1)

    def entropy(self) -> Tensor:
        """Returns the differential entropy, in nats: float32 (...,)."""
        return (self.log_std + 0.5 + _LOG_ROOT_TAU).sum().expand(self.mean.shape[:-1])


@dataclass(frozen=True, eq=False)
class Categorical:
    """Discrete actions.

    Attributes:
        log_probs: float32 (..., choices), normalised.
    """

    log_probs: Tensor

    def sample(self, generator: torch.Generator) -> Tensor:
        """Returns samples, int64 (..., 1); the generator is on the CPU."""
        probabilities = self.log_probs.exp().cpu()
        drawn = probabilities.flatten(end_dim=-2).multinomial(1, generator=generator)
        return drawn.reshape(*probabilities.shape[:-1], 1).to(self.log_probs.device)

    def mode(self) -> Tensor:
        """Returns the most likely actions, int64 (..., 1)."""
        return self.log_probs.argmax(dim=-1, keepdim=True)

    def log_prob(self, actions: Tensor) -> Tensor:
        """Returns the log probability of actions int64 (..., 1): float32 (...,)."""
        return self.log_probs.gather(-1, actions)[..., 0]

    def entropy(self) -> Tensor:
        """Returns the entropy, in nats: float32 (...,)."""
        return -(self.log_probs.exp() * self.log_probs).sum(dim=-1)


Distribution: TypeAlias = Gaussian | Categorical
"""An action distribution."""
