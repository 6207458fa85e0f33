"""Action model of skills: a small network on features of the frame, for each skill."""

import math

import torch
from torch import Tensor, nn
from torch.nn import functional

from freerein.types.common import ActionSpec

_HIDDEN = 64
_LEAST_STD = 0.1
_GAUSSIAN = 0.5 * math.log(2 * math.pi)


class ActionModel(nn.Module):
    """pi(a_t | x_t, c): Gaussian in standardised actions, or categorical for discrete ones.

    The previous action is no input: it would tell the next one better than any skill does. Standard deviations are at
    least a tenth of that of all actions, so that no density is large where a skill hardly moves.

    Args:
        features: D, number of features of a frame.
        skills: K, number of skills.
        action: The action space.
    """

    feature_mean: Tensor
    feature_std: Tensor
    action_mean: Tensor
    action_std: Tensor

    def __init__(self, *, features: int, skills: int, action: ActionSpec) -> None:
        super().__init__()
        self._choices = action.choices
        self.seen = nn.Linear(features, _HIDDEN)
        self.skill = nn.Embedding(skills, _HIDDEN)
        self.hidden = nn.Linear(_HIDDEN, _HIDDEN)
        self.output = nn.Linear(_HIDDEN, action.choices or 2 * action.size)
        for name, size in (("feature", features), ("action", action.size)):
            self.register_buffer(f"{name}_mean", torch.zeros(size))
            self.register_buffer(f"{name}_std", torch.ones(size))

    @torch.no_grad()
    def standardise(self, name: str, values: Tensor) -> None:
        """Sets mean and standard deviation of `feature` or `action` from values (N, D)."""
        getattr(self, f"{name}_mean").copy_(values.float().mean(dim=0))
        getattr(self, f"{name}_std").copy_(values.float().std(dim=0, correction=0).clamp(min=1e-3))

    def forward(self, features: Tensor, actions: Tensor) -> Tensor:
        """Returns log pi(a_t | x_t, c) for each skill, float (N, K): of features (N, D), actions (N, A).

        Densities are those of standardised actions; discrete actions are int64 (N, 1).
        """
        seen = self.seen((features - self.feature_mean) / self.feature_std)  # (N, H)
        x = functional.relu(seen[:, None] + self.skill.weight)  # (N, K, H)
        outputs = self.output(functional.relu(self.hidden(x)))  # (N, K, choices or 2 A)
        if self._choices:
            each = actions[:, None].expand(-1, outputs.shape[1], 1)
            log_p: Tensor = outputs.log_softmax(dim=2).gather(2, each)[:, :, 0]
            return log_p
        mean, raw = outputs.chunk(2, dim=2)  # (N, K, A) each
        std = _LEAST_STD + functional.softplus(raw)
        distance = (((actions - self.action_mean) / self.action_std)[:, None] - mean) / std
        surprise: Tensor = (0.5 * distance.square() + std.log() + _GAUSSIAN).sum(dim=2)
        return -surprise
