"""The networks of chapter 3: a recurrent goal-conditioned skill policy, its forward model, and a goal recognizer."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from freerein.errors import InvalidInput
from freerein.learning.config import bounded
from freerein.learning.encoders import SpatialEncoder
from freerein_imitation.model import action_code
from freerein_imitation.model.recognizer import GoalRecognizer

Memory = tuple[Tensor, Tensor]
"""What an LSTM remembers: hidden state and cell, float32 (1, B, hidden) each."""

_FORWARD_HIDDEN = 256


@dataclass(frozen=True, kw_only=True)
class GoalConditionedSpec:
    """What the networks see and do, and how large they are.

    Attributes:
        camera: Which camera's frames they see.
        action_size: Numbers per action.
        action_choices: How many different actions there are when they are discrete, else 0.
        height: Of the frames, in pixels.
        width: In pixels.
        channels: 1 or 3.
        use_previous_action: Whether the policy sees the action executed last, as in the dissertation.
        forward_model: Whether there is one; only training with forward consistency needs it.
        features: Image features of the policy.
        hidden: Units of its LSTM.
        embedding: Dimensions of the recognizer's embedding.

    Raises:
        InvalidInput: There are 2 channels.
    """

    camera: str
    action_size: int = bounded(1, least=1, most=256)
    action_choices: int = bounded(0, least=0, most=4096)
    height: int = bounded(64, least=4, most=1024)
    width: int = bounded(64, least=4, most=1024)
    channels: int = bounded(3, least=1, most=3)
    use_previous_action: bool = True
    forward_model: bool = False
    features: int = bounded(128, least=8, most=1024)
    hidden: int = bounded(128, least=8, most=1024)
    embedding: int = bounded(64, least=2, most=1024)

    def __post_init__(self) -> None:
        if self.channels == 2:
            raise InvalidInput("Frames must have 1 or 3 channels; got 2.", hint="Store frames as gray or RGB.")

    @property
    def categories(self) -> int:
        """Categories of each number of an action."""
        return self.action_choices or action_code.BINS


class GoalConditionedNetwork(nn.Module):
    """All that is learned from exploration: policy, forward model and recognizer, which share no weight.

    Args:
        spec: What they see and do.
    """

    def __init__(self, spec: GoalConditionedSpec) -> None:
        super().__init__()
        self.spec = spec
        self.policy = SkillPolicyNetwork(spec)
        self.forward_model = ForwardModel(spec) if spec.forward_model else None
        self.recognizer = GoalRecognizer(
            height=spec.height, width=spec.width, channels=spec.channels, embedding=spec.embedding
        )

    def calibrate(self, frames: Tensor) -> None:
        """Takes the mean image, and the deviation from it, from training frames, uint8 (N, H, W, C)."""
        self.policy.image.fit_normalisation(frames)
        self.recognizer.image.fit_normalisation(frames)


class SkillPolicyNetwork(nn.Module):
    """The goal-conditioned skill policy pi of eq. 3.4: P(a_t | phi(x_t), phi(x_g), a_{t-1}, h_{t-1}).

    Args:
        spec: What it sees and does.
    """

    def __init__(self, spec: GoalConditionedSpec) -> None:
        super().__init__()
        self.spec = spec
        self.image = SpatialEncoder(
            height=spec.height, width=spec.width, channels=spec.channels, features=spec.features
        )
        previous = spec.action_choices or spec.action_size
        self.join = nn.Linear(2 * spec.features + previous, spec.hidden)
        self.lstm = nn.LSTM(spec.hidden, spec.hidden, batch_first=True)
        self.head = nn.Linear(2 * spec.hidden, spec.action_size * spec.categories)

    def forward(
        self, seen: Tensor, goal: Tensor, previous: Tensor, memory: Memory | None = None
    ) -> tuple[Tensor, Memory]:
        """Returns the scores of every action's categories, and the memory after the last timestep.

        Args:
            seen: phi(x_t), float32 (B, T, features).
            goal: phi(x_g), float32 (B, features).
            previous: a_{t-1}, float32 (B, T, A), zeros where nothing was executed, or int64 (B, T, 1), -1 there.
            memory: Before the first timestep; None where a goal begins.

        Returns:
            Scores, float32 (B, T, A, categories), and the memory.
        """
        executed = self._executed(previous)
        joined = torch.cat([seen, goal[:, None].expand_as(seen), executed], dim=2)
        now = functional.relu(self.join(joined))  # (B, T, hidden)
        remembered, memory = self.lstm(now, memory)  # (B, T, hidden)
        scores: Tensor = self.head(torch.cat([now, remembered], dim=2))  # (B, T, A * categories)
        return scores.view(*scores.shape[:2], self.spec.action_size, self.spec.categories), memory

    def _executed(self, previous: Tensor) -> Tensor:
        if self.spec.action_choices:
            previous = action_code.encode(previous, choices=self.spec.action_choices).flatten(2)  # (B, T, choices)
        return previous if self.spec.use_previous_action else torch.zeros_like(previous)


class ForwardModel(nn.Module):
    """f of eq. 3.4: from phi(x_t) and the code of a_t to phi(x_{t+1}).

    Args:
        spec: The policy's.
    """

    def __init__(self, spec: GoalConditionedSpec) -> None:
        super().__init__()
        self.hidden = nn.Linear(spec.features + spec.action_size * spec.categories, _FORWARD_HIDDEN)
        self.change = nn.Linear(_FORWARD_HIDDEN, spec.features)

    def forward(self, seen: Tensor, action: Tensor) -> Tensor:
        """Returns what is seen next, float32 (..., features): what is seen now and how it changes.

        Args:
            seen: phi(x_t), float32 (..., features).
            action: The code of a_t or a predicted distribution, float32 (..., A, categories).
        """
        joined = torch.cat([seen, action.flatten(-2)], dim=-1)
        change: Tensor = self.change(functional.relu(self.hidden(joined)))
        return seen + change
