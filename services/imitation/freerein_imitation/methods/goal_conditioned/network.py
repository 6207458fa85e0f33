"""The goal-conditioned skill policy (GSP) of chapter 3: a recurrent policy and a forward model."""

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

import torch
from torch import Tensor, nn
from torch.nn import functional

from freerein.learning.encoders import FrameTensors
from freerein_imitation.methods.shared import action_bins
from freerein_imitation.methods.shared.goal_images.network import ActionNetwork, GoalImagesNetwork, GoalImagesSpec

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
        recurrent: Whether the policy has a recurrent layer.
        stop: Whether the policy tells by an action of its own that the goal is reached; there is no recognizer then.
        forward_model: Whether there is a forward model, which is needed in training only.
        forward_target: Target of its predictions.
    """

    use_previous_action: bool = True
    recurrent: bool = True
    stop: bool = False
    forward_model: bool = False
    forward_target: Literal["features", "pixels"] = "features"


class GoalConditionedNetwork(GoalImagesNetwork):
    """Policy, goal recognizer and forward model, which share no weights."""

    spec: GoalConditionedSpec
    policy: "SkillPolicyNetwork"

    def __init__(self, spec: GoalConditionedSpec) -> None:
        super().__init__(spec, SkillPolicyNetwork(spec))
        self.forward_model = ForwardModel(spec, self.policy.action_head.size) if spec.forward_model else None


class SkillPolicyNetwork(ActionNetwork):
    """The policy pi of eq. 3.4: P(a_t | phi(x_t), phi(x_g), a_{t-1}, h_{t-1})."""

    def __init__(self, spec: GoalConditionedSpec) -> None:
        super().__init__(spec)
        self.spec = spec
        self.input_layer = nn.Linear(self.seen_size + spec.encoded_action_size, spec.hidden_size)
        self.lstm = nn.LSTM(spec.hidden_size, spec.hidden_size, batch_first=True) if spec.recurrent else None
        hidden = 2 * spec.hidden_size if spec.recurrent else spec.hidden_size
        self.recurrent_size = hidden if spec.recurrent else 0
        self.action_head = spec.make_head(hidden)
        self.stop_head = nn.Linear(hidden + 2 * self.action_head.code_size, 1) if spec.stop else None

    def forward(
        self, codes: Tensor, goals: Tensor, previous: Tensor, state: LSTMState | None = None
    ) -> tuple[Tensor, LSTMState | None]:
        """Returns contexts, float32 (B, T, C), and the LSTM state after the last timestep, if there is an LSTM.

        Args:
            codes: Of observations, beginning with phi(x_t), float32 (B, T, code size).
            goals: Of goals, beginning with phi(x_g), float32 (B, code size).
            previous: a_{t-1}, float32 (B, T, A), zeros for no action, or int64 (B, T, 1), -1 for no action.
            state: LSTM state before the first timestep; None at the start of a goal.
        """
        ahead = goals[:, None].expand_as(codes)
        inputs = torch.cat([self.seen(codes, ahead), self._previous(previous)], dim=2)
        hidden = functional.relu(self.input_layer(inputs))
        if self.lstm is None:
            return self.context(hidden, codes, ahead), None
        recurrent, state = self.lstm(hidden, state)  # (B, T, hidden_size)
        return self.context(torch.cat([hidden, recurrent], dim=2), codes, ahead), state

    def step(self, codes: Tensor, goals: Tensor, previous: Tensor, recurrent: Tensor) -> tuple[Tensor, Tensor]:
        """Returns contexts, and the next recurrent states; see `ActionNetwork.step`."""
        hidden, cell = (each.contiguous() for each in recurrent[None].chunk(2, dim=2))
        context, state = self(codes[:, None], goals, previous[:, None], (hidden, cell))
        return context[:, 0], recurrent if state is None else torch.cat(state, dim=2)[0]

    def _previous(self, previous: Tensor) -> Tensor:
        if self.spec.action.choices:
            previous = action_bins.encode(previous, choices=self.spec.action.choices).flatten(2)  # (B, T, choices)
        return previous if self.spec.use_previous_action else torch.zeros_like(previous)


class ForwardModel(nn.Module):
    """f of eq. 3.4, or of eq. 3.3: what is observed at t + 1, from phi(x_t) and the distribution of a_t."""

    def __init__(self, spec: GoalConditionedSpec, action_size: int) -> None:
        super().__init__()
        self._sizes = {
            camera.name: (min(camera.height, _PIXELS_SIDE), min(camera.width, _PIXELS_SIDE)) for camera in spec.cameras
        }
        self._predicts_pixels = spec.forward_target == "pixels"
        features = spec.features * len(spec.cameras)
        pixels = sum(camera.channels * math.prod(self._sizes[camera.name]) for camera in spec.cameras)
        self.hidden = nn.Linear(features + action_size, _FORWARD_HIDDEN)
        self.residual = nn.Linear(_FORWARD_HIDDEN, pixels if self._predicts_pixels else features)

    def observed(self, features: Tensor, frames: FrameTensors) -> Tensor:
        """Returns the prediction targets of frames: their features, or pixels; float32 (N, O).

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
        """Returns the predicted next observation, float32 (..., O).

        Args:
            features: phi(x_t), float32 (..., D).
            action: Target or predicted distributions of a_t, float32 (..., action size).
            observed: Observation at t, float32 (..., O).
        """
        inputs = torch.cat([features, action], dim=-1)
        residual: Tensor = self.residual(functional.relu(self.hidden(inputs)))
        return observed + residual
