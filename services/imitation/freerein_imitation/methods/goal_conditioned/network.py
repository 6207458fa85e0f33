"""The goal-conditioned skill policy (GSP) of chapter 3: a recurrent policy and a forward model."""

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

import torch
from torch import Tensor, nn
from torch.nn import functional

from freerein.learning.encoders import ENCODERS, CameraEncoders, FrameTensors
from freerein_imitation.methods.shared import action_bins
from freerein_imitation.methods.shared.goal_images.network import GoalImagesNetwork, GoalImagesSpec

LSTMState: TypeAlias = tuple[Tensor, Tensor]
"""Hidden state and cell, float32 (1, B, units) each."""

_FORWARD_HIDDEN = 256
_PIXELS_SIDE = 16
"""Most rows and columns of the image that a forward model of pixels predicts."""


@dataclass(frozen=True, kw_only=True)
class GoalConditionedSpec(GoalImagesSpec):
    """Inputs, outputs and sizes of the networks.

    Attributes:
        use_previous_action: Whether the policy takes the previous action as input, as in the dissertation.
        forward_model: Whether there is a forward model, which is needed in training only.
        forward_target: What it predicts.
    """

    use_previous_action: bool = True
    forward_model: bool = False
    forward_target: Literal["features", "pixels"] = "features"


class GoalConditionedNetwork(GoalImagesNetwork):
    """Policy, goal recognizer and forward model, which share no weights."""

    spec: GoalConditionedSpec
    policy: "SkillPolicyNetwork"

    def __init__(self, spec: GoalConditionedSpec) -> None:
        super().__init__(spec, SkillPolicyNetwork(spec))
        self.forward_model = ForwardModel(spec) if spec.forward_model else None


class SkillPolicyNetwork(nn.Module):
    """The policy pi of eq. 3.4: P(a_t | phi(x_t), phi(x_g), a_{t-1}, h_{t-1})."""

    def __init__(self, spec: GoalConditionedSpec) -> None:
        super().__init__()
        self.spec = spec
        self.recurrent_size = 2 * spec.hidden_size
        self.encoder = CameraEncoders(ENCODERS[spec.encoder], spec.cameras, features=spec.features)
        self.input_layer = nn.Linear(2 * self.encoder.size + spec.encoded_action_size, spec.hidden_size)
        self.lstm = nn.LSTM(spec.hidden_size, spec.hidden_size, batch_first=True)
        self.action_head = nn.Linear(2 * spec.hidden_size, spec.action.size * spec.categories)

    def forward(
        self, features: Tensor, goal: Tensor, previous: Tensor, state: LSTMState | None = None
    ) -> tuple[Tensor, LSTMState]:
        """Returns action logits, float32 (B, T, A, categories), and the LSTM state after the last timestep.

        Args:
            features: phi(x_t), float32 (B, T, D).
            goal: phi(x_g), float32 (B, D).
            previous: a_{t-1}, float32 (B, T, A), zeros for no action, or int64 (B, T, 1), -1 for no action.
            state: LSTM state before the first timestep; None at the start of a goal.
        """
        inputs = torch.cat([features, goal[:, None].expand_as(features), self._previous(previous)], dim=2)
        hidden = functional.relu(self.input_layer(inputs))  # (B, T, hidden_size)
        recurrent, state = self.lstm(hidden, state)  # (B, T, hidden_size)
        logits: Tensor = self.action_head(torch.cat([hidden, recurrent], dim=2))  # (B, T, A * categories)
        return logits.view(*logits.shape[:2], self.spec.action.size, self.spec.categories), state

    def step(self, features: Tensor, goal: Tensor, previous: Tensor, recurrent: Tensor) -> tuple[Tensor, Tensor]:
        """Returns the logits of one action, and the next recurrent states; see `ActionNetwork.step`."""
        hidden, cell = (each.contiguous() for each in recurrent[None].chunk(2, dim=2))
        logits, state = self(features[:, None], goal, previous[:, None], (hidden, cell))
        return logits, torch.cat(state, dim=2)[0]

    def _previous(self, previous: Tensor) -> Tensor:
        if self.spec.action.choices:
            previous = action_bins.encode(previous, choices=self.spec.action.choices).flatten(2)  # (B, T, choices)
        return previous if self.spec.use_previous_action else torch.zeros_like(previous)


class ForwardModel(nn.Module):
    """f of eq. 3.4, or of eq. 3.3: what is observed at t + 1, from phi(x_t) and the distribution of a_t."""

    def __init__(self, spec: GoalConditionedSpec) -> None:
        super().__init__()
        self._sizes = {
            camera.name: (min(camera.height, _PIXELS_SIDE), min(camera.width, _PIXELS_SIDE)) for camera in spec.cameras
        }
        self._predicts_pixels = spec.forward_target == "pixels"
        features = spec.features * len(spec.cameras)
        pixels = sum(camera.channels * math.prod(self._sizes[camera.name]) for camera in spec.cameras)
        self.hidden = nn.Linear(features + spec.action.size * spec.categories, _FORWARD_HIDDEN)
        self.residual = nn.Linear(_FORWARD_HIDDEN, pixels if self._predicts_pixels else features)

    def observed(self, features: Tensor, frames: FrameTensors) -> Tensor:
        """Returns what the model predicts, as it is observed in frames: their features, or pixels; float32 (N, O).

        Args:
            features: phi of the frames, float32 (N, D).
            frames: By camera, uint8 (N, H, W, C).
        """
        if not self._predicts_pixels:
            return features.detach()
        images = (
            functional.adaptive_avg_pool2d(frames[name].permute(0, 3, 1, 2) / 255, size)
            for name, size in self._sizes.items()
        )
        return torch.cat([each.flatten(start_dim=1) for each in images], dim=1)

    def forward(self, features: Tensor, action: Tensor, observed: Tensor) -> Tensor:
        """Returns what is observed next, float32 (..., O).

        Args:
            features: phi(x_t), float32 (..., D).
            action: Target or predicted distribution of a_t, float32 (..., A, categories).
            observed: What is observed at t, float32 (..., O).
        """
        inputs = torch.cat([features, action.flatten(-2)], dim=-1)
        residual: Tensor = self.residual(functional.relu(self.hidden(inputs)))
        return observed + residual
