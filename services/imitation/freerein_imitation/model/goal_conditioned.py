"""The goal-conditioned skill policy (GSP) of chapter 3: recurrent policy, forward model, goal recognizer."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn
from torch.nn import functional

from freerein.learning import model_files
from freerein.learning.config import bounded
from freerein.learning.encoders import SpatialEncoder
from freerein_imitation.model import action_bins
from freerein_imitation.model.policy import ControlSpec, PolicyNetworkSpec, PolicyOutput, TorchPolicy, flat_lstm_state

LSTMState = tuple[Tensor, Tensor]
"""Hidden state and cell, float32 (1, B, hidden_size) each."""

_FORWARD_HIDDEN = 256
_MAX_LOGIT = 5.0  # the recognizer's, of two equal images
_ENCODE_BATCH = 256


@dataclass(frozen=True, kw_only=True)
class GoalConditionedSpec(PolicyNetworkSpec):
    """Inputs, outputs and sizes of the networks.

    Attributes:
        use_previous_action: Whether the policy takes the previous action as input, as in the dissertation.
        forward_model: Whether there is a forward model, which only forward consistency needs.
        features: Size of the policy's image features.
        hidden_size: Units of the LSTM.
        embedding_size: Size of the recognizer's embeddings.
    """

    use_previous_action: bool = True
    forward_model: bool = False
    features: int = bounded(128, least=8, most=1024)
    hidden_size: int = bounded(128, least=8, most=1024)
    embedding_size: int = bounded(64, least=2, most=1024)

    @property
    def categories(self) -> int:
        """Categories of each number of an action."""
        return self.action_choices or action_bins.BINS


class GoalConditionedNetwork(nn.Module):
    """Policy, forward model and goal recognizer, which share no weights.

    Args:
        spec: Inputs, outputs and sizes.
    """

    def __init__(self, spec: GoalConditionedSpec) -> None:
        super().__init__()
        self.spec = spec
        self.policy = SkillPolicyNetwork(spec)
        self.forward_model = ForwardModel(spec) if spec.forward_model else None
        self.recognizer = GoalRecognizer(spec)

    def fit_normalisation(self, frames: Tensor) -> None:
        """Sets the encoders' mean image and pixel deviation from training frames, uint8 (N, H, W, C)."""
        self.policy.encoder.fit_normalisation(frames)
        self.recognizer.encoder.fit_normalisation(frames)


class SkillPolicyNetwork(nn.Module):
    """The policy pi of eq. 3.4: P(a_t | phi(x_t), phi(x_g), a_{t-1}, h_{t-1}).

    Args:
        spec: Inputs, outputs and sizes.
    """

    def __init__(self, spec: GoalConditionedSpec) -> None:
        super().__init__()
        self.spec = spec
        self.encoder = SpatialEncoder(
            height=spec.height, width=spec.width, channels=spec.channels, features=spec.features
        )
        self.input_layer = nn.Linear(2 * spec.features + spec.flat_action_size, spec.hidden_size)
        self.lstm = nn.LSTM(spec.hidden_size, spec.hidden_size, batch_first=True)
        self.action_head = nn.Linear(2 * spec.hidden_size, spec.action_size * spec.categories)

    def forward(
        self, features: Tensor, goal: Tensor, previous: Tensor, state: LSTMState | None = None
    ) -> tuple[Tensor, LSTMState]:
        """Returns action logits, float32 (B, T, A, categories), and the LSTM state after the last timestep.

        Args:
            features: phi(x_t), float32 (B, T, features).
            goal: phi(x_g), float32 (B, features).
            previous: a_{t-1}, float32 (B, T, A), zeros for no action, or int64 (B, T, 1), -1 for no action.
            state: LSTM state before the first timestep; None at the start of a goal.
        """
        inputs = torch.cat([features, goal[:, None].expand_as(features), self._previous(previous)], dim=2)
        hidden = functional.relu(self.input_layer(inputs))  # (B, T, hidden_size)
        recurrent, state = self.lstm(hidden, state)  # (B, T, hidden_size)
        logits: Tensor = self.action_head(torch.cat([hidden, recurrent], dim=2))  # (B, T, A * categories)
        return logits.view(*logits.shape[:2], self.spec.action_size, self.spec.categories), state

    def _previous(self, previous: Tensor) -> Tensor:
        if self.spec.action_choices:
            previous = action_bins.encode(previous, choices=self.spec.action_choices).flatten(2)  # (B, T, choices)
        return previous if self.spec.use_previous_action else torch.zeros_like(previous)


class ForwardModel(nn.Module):
    """f of eq. 3.4: phi(x_{t+1}) from phi(x_t) and the distribution of a_t.

    Args:
        spec: The policy's.
    """

    def __init__(self, spec: GoalConditionedSpec) -> None:
        super().__init__()
        self.hidden = nn.Linear(spec.features + spec.action_size * spec.categories, _FORWARD_HIDDEN)
        self.residual = nn.Linear(_FORWARD_HIDDEN, spec.features)

    def forward(self, features: Tensor, action: Tensor) -> Tensor:
        """Returns the next features, float32 (..., features).

        Args:
            features: phi(x_t), float32 (..., features).
            action: Target or predicted distribution of a_t, float32 (..., A, categories).
        """
        inputs = torch.cat([features, action.flatten(-2)], dim=-1)
        residual: Tensor = self.residual(functional.relu(self.hidden(inputs)))
        return features + residual


class GoalRecognizer(nn.Module):
    """The goal recognizer of section 3.2 as a metric embedding: images a few actions apart are less than 1 apart.

    The dissertation leaves the network open. In a metric nothing is closer to a goal than the goal's own image.

    Args:
        spec: The policy's.
    """

    def __init__(self, spec: GoalConditionedSpec) -> None:
        super().__init__()
        size = spec.embedding_size
        self.encoder = SpatialEncoder(height=spec.height, width=spec.width, channels=spec.channels, features=size)
        self.projection = nn.Linear(size, size, bias=False)

    def forward(self, frames: Tensor) -> Tensor:
        """Returns embeddings, float32 (N, embedding_size), of frames uint8 (N, H, W, C)."""
        embedding: Tensor = self.projection(self.encoder(frames))
        return embedding


def proximity_logit(observation: Tensor, goal: Tensor) -> Tensor:
    """Returns the logit that two embeddings (..., embedding_size) are close, float32 (...)."""
    distance: Tensor = torch.linalg.vector_norm(observation - goal, dim=-1)
    return _MAX_LOGIT * (1 - distance)


class GoalConditionedPolicy(TorchPolicy[GoalConditionedNetwork]):
    """Follows goal images.

    Args:
        network: Trained.
        control: Actions, rate and limits.
    """

    kind: Literal["goal_conditioned"] = "goal_conditioned"

    def __init__(self, network: GoalConditionedNetwork, control: ControlSpec) -> None:
        recurrent_size = 2 * network.spec.hidden_size
        super().__init__(network, network.spec, control, goal_form="images", recurrent_size=recurrent_size)

    @classmethod
    def load(cls, folder: Path, device: str) -> "GoalConditionedPolicy":
        """Returns the policy in a folder; see `freerein_imitation.model.load`."""
        network = model_files.load_model(folder, GoalConditionedSpec, GoalConditionedNetwork, device=device)
        return cls(network, ControlSpec.from_card(model_files.read_card(folder)))

    @torch.inference_mode()
    def encode_goals(self, goals: npt.NDArray[np.uint8]) -> npt.NDArray[np.float32]:
        """Returns goal embeddings, float32 (N, G), of goal images, uint8 (N, H, W, C)."""
        batches = [goals[start : start + _ENCODE_BATCH] for start in range(0, len(goals), _ENCODE_BATCH)]
        embeddings: npt.NDArray[np.float32] = torch.cat([self._encode(batch) for batch in batches]).cpu().numpy()
        return embeddings

    @torch.inference_mode()
    def step(
        self,
        frames: npt.NDArray[np.uint8],
        goals: npt.NDArray[np.float32],
        previous: npt.NDArray[Any],
        recurrent: npt.NDArray[np.float32],
    ) -> PolicyOutput:
        """Returns actions and the probability that the goal is reached; arguments as in `Policy.step`."""
        goal, features = self._tensor(goals), self._network.spec.features
        state = self._lstm_state(recurrent)
        encoded = self._encode(frames)  # (B, G)
        logits, state = self._network.policy(
            encoded[:, None, :features], goal[:, :features], self._tensor(previous)[:, None], state
        )
        reached = proximity_logit(encoded[:, features:], goal[:, features:]).sigmoid()
        return PolicyOutput(
            actions=action_bins.decode(logits, choices=self.spec.action.choices).cpu().numpy(),
            reached=reached.cpu().numpy(),
            recurrent=flat_lstm_state(state),
        )

    def _encode(self, frames: npt.NDArray[np.uint8]) -> Tensor:
        """Returns the policy's features beside the recognizer's embedding, float32 (N, G)."""
        tensor = self._tensor(frames)
        return torch.cat([self._network.policy.encoder(tensor), self._network.recognizer(tensor)], dim=1)
