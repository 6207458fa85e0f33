"""The skill policies of section 2.4 as one recurrent network that takes a skill, with a termination head."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn
from torch.nn import functional

from freerein.errors import InvalidInput
from freerein.learning import model_files
from freerein.learning.config import bounded, one_of
from freerein.learning.encoders import ENCODERS, CameraEncoders
from freerein.learning.image_statistics import image_statistics, statistics_size
from freerein.learning.in_distribution import InDistribution
from freerein.learning.inputs import InputSpec
from freerein_imitation.model import action_bins
from freerein_imitation.model.colour_attention import ColourAttention
from freerein_imitation.model.policy import (
    CameraFrames,
    ControlSpec,
    LSTMState,
    PolicyOutput,
    TorchPolicy,
    confidence,
    flat_lstm_state,
    lstm_state,
)


@dataclass(frozen=True, kw_only=True)
class SkillsSpec(InputSpec):
    """Inputs, outputs and sizes of a network.

    Attributes:
        skills: Names of the skills.
        encoder: Image encoder.
        features: Image features per camera.
        hidden_size: Units of the hidden layers.
        recurrent_size: Units of the LSTM.

    Raises:
        InvalidInput: There are no skills, or cameras or actions are out of bounds.
    """

    skills: tuple[str, ...]
    encoder: str = one_of(ENCODERS, "colour_codebook")
    features: int = bounded(160, least=8, most=1280)
    hidden_size: int = bounded(128, least=8, most=1024)
    recurrent_size: int = bounded(64, least=8, most=1024)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.skills:
            raise InvalidInput("A policy must have at least 1 skill; got 0.", hint="Label the dataset with skills.")


class SkillsNetwork(nn.Module):
    """pi(a_t | x_1..x_t, a_{t-1}, skill), and the probability that the skill terminates at x_t.

    Args:
        spec: Inputs, outputs and sizes.

    Attributes:
        attention: Of skills over colours; None where features are no colour moments.
    """

    feature_mean: Tensor
    feature_std: Tensor

    def __init__(self, spec: SkillsSpec) -> None:
        super().__init__()
        self.spec = spec
        self.encoder = CameraEncoders(ENCODERS[spec.encoder], spec.cameras, features=spec.features)
        size, cameras, skills = self.encoder.size, len(spec.cameras), len(spec.skills)
        moments = self.encoder.has_colour_moments
        self.attention = ColourAttention(cameras=cameras, features=spec.features, skills=skills) if moments else None
        attended = self.attention.size if self.attention else 0
        self.input_layer = nn.Linear(size + attended + spec.encoded_action_size + skills, spec.hidden_size)
        self.hidden_layer = nn.Linear(spec.hidden_size, spec.hidden_size)
        self.lstm = nn.LSTM(spec.hidden_size, spec.recurrent_size, batch_first=True)
        self.trunk = nn.Linear(spec.recurrent_size + spec.hidden_size, spec.hidden_size)
        self.action_layer = nn.Linear(spec.hidden_size, spec.hidden_size)
        self.action_head = nn.Linear(spec.hidden_size, spec.encoded_action_size)
        self.termination_head = nn.Linear(spec.hidden_size, 1)
        self.in_distribution = InDistribution(statistics_size(spec.cameras))
        self.register_buffer("feature_mean", torch.zeros(size))
        self.register_buffer("feature_std", torch.ones(size))

    @torch.no_grad()
    def fit_feature_normalisation(self, features: Tensor, *, generator: torch.Generator) -> None:
        """Sets mean and deviation of a frozen encoder's features, float32 (N, D), and draws attention weights."""
        self.feature_mean.copy_(features.mean(dim=0))
        self.feature_std.copy_(features.std(dim=0) + 0.01)
        if self.attention is not None:
            self.attention.draw(generator)

    def forward(
        self, features: Tensor, skill: Tensor, previous: Tensor, state: LSTMState | None = None
    ) -> tuple[Tensor, Tensor, LSTMState]:
        """Returns actions, termination logits, and the LSTM state after the last timestep.

        Args:
            features: Image features, float32 (B, T, D), from `encoder`.
            skill: One-hot, float32 (B, skills).
            previous: a_{t-1}, float32 (B, T, A), zeros for no action, or int64 (B, T, 1), -1 for no action.
            state: LSTM state before the first timestep; None at the start of a skill.

        Returns:
            Actions, float32 (B, T, A), not clipped, or logits of discrete ones, (B, T, 1, choices); termination
            logits, float32 (B, T); the LSTM state.
        """
        skills = skill[:, None].expand(-1, features.shape[1], -1)  # (B, T, skills)
        attended = [self.attention(features, skills)] if self.attention is not None else []
        normalised = (features - self.feature_mean) / self.feature_std  # (B, T, D)
        inputs = torch.cat([normalised, *attended, self._previous(previous), skills], dim=2)
        hidden = functional.relu(self.hidden_layer(functional.relu(self.input_layer(inputs))))  # (B, T, hidden_size)
        recurrent, state = self.lstm(hidden, state)  # (B, T, recurrent_size)
        trunk = functional.relu(self.trunk(torch.cat([recurrent, hidden], dim=2)))  # (B, T, hidden_size)
        action = self.action_head(functional.relu(self.action_layer(trunk)))  # (B, T, A or choices)
        terminations = self.termination_head(trunk)[..., 0]  # (B, T)
        return action[:, :, None] if self.spec.action.choices else action, terminations, state

    def _previous(self, previous: Tensor) -> Tensor:
        if self.spec.action.choices:
            return action_bins.encode(previous, choices=self.spec.action.choices).flatten(2)  # (B, T, choices)
        return previous


class SkillsPolicy(TorchPolicy[SkillsNetwork]):
    """Executes skills by name.

    Args:
        network: Trained.
        control: Rate and limits.
    """

    def __init__(self, network: SkillsNetwork, control: ControlSpec) -> None:
        spec = network.spec
        size = 2 * spec.recurrent_size
        super().__init__(network, spec, control, goal_form="recipe", skills=spec.skills, recurrent_size=size)

    @classmethod
    def load(cls, folder: Path, device: str) -> "SkillsPolicy":
        """Returns the policy in a folder; see `freerein.learning.methods.Method`."""
        network = model_files.load_model(folder, SkillsSpec, SkillsNetwork, device=device)
        return cls(network, ControlSpec.from_card(model_files.read_card(folder)))

    def encode_goals(self, goals: Sequence[str]) -> npt.NDArray[np.float32]:
        """Returns one-hot codes of skill names, float32 (N, skills).

        Raises:
            InvalidInput: A name is not a skill of this policy.
        """
        skills = self.spec.skills
        unknown = sum(goal not in skills for goal in goals)
        if unknown:
            raise InvalidInput(
                f"Skills must be among {', '.join(skills)}; {unknown} of {len(goals)} are not.",
                field="goal",
                hint="GetSpec lists a model's skills.",
            )
        return np.eye(len(skills), dtype=np.float32)[[skills.index(goal) for goal in goals]]

    @torch.inference_mode()
    def step(
        self,
        frames: CameraFrames,
        goals: npt.NDArray[np.float32],
        previous: npt.NDArray[Any],
        recurrent: npt.NDArray[np.float32],
    ) -> PolicyOutput:
        """Returns the output for B observations; arguments as in `Policy.step`."""
        seen, score = self._tensors(frames), self._network.in_distribution
        actions, termination, state = self._network(
            self._network.encoder(seen)[:, None],
            self._tensor(goals),
            self._tensor(previous)[:, None],
            lstm_state(self._tensor(recurrent)),
        )
        reached = termination[:, 0].sigmoid()
        chosen = actions.argmax(dim=3) if self.spec.action.choices else actions.clamp(-1, 1)  # (B, 1, A)
        return PolicyOutput(
            actions=chosen.cpu().numpy(),
            reached=reached.cpu().numpy(),
            recurrent=flat_lstm_state(state).cpu().numpy(),
            in_distribution=score(score.distance(image_statistics(seen)), confidence(reached)).cpu().numpy(),
        )
