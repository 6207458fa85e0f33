"""The skill policies of section 2.4 as one recurrent network that takes a skill, with a termination head.

A few attention heads per skill choose whose position matters; differences between heads are relative positions. What is
learned of one skill so serves all.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn
from torch.nn import functional

from freerein.errors import InvalidInput
from freerein.learning import model_files
from freerein.learning.config import bounded
from freerein_imitation.model import action_bins
from freerein_imitation.model.colour_codebook import MOMENTS, ColourCodebook
from freerein_imitation.model.policy import ControlSpec, PolicyNetworkSpec, PolicyOutput, TorchPolicy, flat_lstm_state

LSTMState = tuple[Tensor, Tensor]
"""Hidden state and cell, float32 (1, B, recurrent_size) each."""

_HEADS = 8
_GAIN = 10.0  # positions are in [-1, 1], and a few hundredths decide whether a grasp succeeds
_PRESENCE_FLOOR = 0.05


@dataclass(frozen=True, kw_only=True)
class SkillsSpec(PolicyNetworkSpec):
    """Inputs, outputs and sizes of a network.

    Attributes:
        skills: Names of the skills.
        codebook_size: Colours in the codebook.
        hidden_size: Units of the hidden layers.
        recurrent_size: Units of the LSTM.

    Raises:
        InvalidInput: There are no skills, or 2 channels.
    """

    skills: tuple[str, ...]
    codebook_size: int = bounded(32, least=2, most=256)
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
    """

    feature_mean: Tensor
    feature_std: Tensor

    def __init__(self, spec: SkillsSpec) -> None:
        super().__init__()
        self.spec = spec
        self.codebook = ColourCodebook(
            height=spec.height, width=spec.width, channels=spec.channels, size=spec.codebook_size
        )
        self.attention = nn.Linear(len(spec.skills), _HEADS * spec.codebook_size, bias=False)
        pairs = _HEADS * (_HEADS - 1) // 2
        inputs = MOMENTS * (spec.codebook_size + _HEADS) + 2 * pairs + spec.flat_action_size + len(spec.skills)
        self.input_layer = nn.Linear(inputs, spec.hidden_size)
        self.hidden_layer = nn.Linear(spec.hidden_size, spec.hidden_size)
        self.lstm = nn.LSTM(spec.hidden_size, spec.recurrent_size, batch_first=True)
        self.trunk = nn.Linear(spec.recurrent_size + spec.hidden_size, spec.hidden_size)
        self.action_layer = nn.Linear(spec.hidden_size, spec.hidden_size)
        self.action_head = nn.Linear(spec.hidden_size, spec.flat_action_size)
        self.termination_head = nn.Linear(spec.hidden_size, 1)
        self.register_buffer("feature_mean", torch.zeros(spec.codebook_size * MOMENTS))
        self.register_buffer("feature_std", torch.ones(spec.codebook_size * MOMENTS))

    @torch.no_grad()
    def fit_normalisation(self, moments: Tensor, *, generator: torch.Generator) -> None:
        """Sets feature mean and deviation from training frames, and draws attention weights to different colours.

        Args:
            moments: Colour moments of these frames, float32 (N, colours, MOMENTS).
            generator: On the CPU.
        """
        flat = moments.flatten(1)
        self.feature_mean.copy_(flat.mean(dim=0))
        self.feature_std.copy_(flat.std(dim=0) + 0.01)
        self.attention.weight.normal_(generator=generator)

    def forward(
        self, moments: Tensor, skill: Tensor, previous: Tensor, state: LSTMState | None = None
    ) -> tuple[Tensor, Tensor, LSTMState]:
        """Returns actions, termination logits, and the LSTM state after the last timestep.

        Args:
            moments: Colour moments, float32 (B, T, colours, MOMENTS), from `codebook`.
            skill: One-hot, float32 (B, skills).
            previous: a_{t-1}, float32 (B, T, A), zeros for no action, or int64 (B, T, 1), -1 for no action.
            state: LSTM state before the first timestep; None at the start of a skill.

        Returns:
            Actions, float32 (B, T, A), not clipped, or logits of discrete ones, (B, T, 1, choices); termination
            logits, float32 (B, T); the LSTM state.
        """
        skills = skill[:, None].expand(-1, moments.shape[1], -1)  # (B, T, skills)
        normalised = (moments.flatten(2) - self.feature_mean) / self.feature_std  # (B, T, colours * MOMENTS)
        inputs = torch.cat([normalised, *self._attend(moments, skills), self._previous(previous), skills], dim=2)
        hidden = functional.relu(self.hidden_layer(functional.relu(self.input_layer(inputs))))  # (B, T, hidden_size)
        recurrent, state = self.lstm(hidden, state)  # (B, T, recurrent_size)
        trunk = functional.relu(self.trunk(torch.cat([recurrent, hidden], dim=2)))  # (B, T, hidden_size)
        action = self.action_head(functional.relu(self.action_layer(trunk)))  # (B, T, A or choices)
        terminations = self.termination_head(trunk)[..., 0]  # (B, T)
        return action[:, :, None] if self.spec.action_choices else action, terminations, state

    def _attend(self, moments: Tensor, skills: Tensor) -> tuple[Tensor, Tensor]:
        """Returns attended moments, (B, T, heads * MOMENTS), and relative positions of heads, (B, T, pairs * 2).

        Absent colours get little attention: the logarithm of a colour's mass is added to its logit.
        """
        logits = self.attention(skills).unflatten(2, (_HEADS, -1))  # (B, T, heads, colours)
        presence = (moments[..., 0].clamp(min=0) + _PRESENCE_FLOOR).log()  # (B, T, colours)
        attended = (logits + presence[:, :, None]).softmax(dim=3) @ moments  # (B, T, heads, MOMENTS)
        first, second = torch.triu_indices(_HEADS, _HEADS, offset=1, device=moments.device)
        relative = attended[:, :, first, 1:3] - attended[:, :, second, 1:3]  # (B, T, pairs, 2)
        return _GAIN / 2 * attended.flatten(2), _GAIN * relative.flatten(2)

    def _previous(self, previous: Tensor) -> Tensor:
        if self.spec.action_choices:
            return action_bins.encode(previous, choices=self.spec.action_choices).flatten(2)  # (B, T, choices)
        return previous


class SkillsPolicy(TorchPolicy[SkillsNetwork]):
    """Executes skills by name.

    Args:
        network: Trained.
        control: Actions, rate and limits.
    """

    kind: Literal["skills"] = "skills"

    def __init__(self, network: SkillsNetwork, control: ControlSpec) -> None:
        spec = network.spec
        size = 2 * spec.recurrent_size
        super().__init__(network, spec, control, goal_form="recipe", skills=spec.skills, recurrent_size=size)

    @classmethod
    def load(cls, folder: Path, device: str) -> "SkillsPolicy":
        """Returns the policy in a folder; see `freerein_imitation.model.load`."""
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
        frames: npt.NDArray[np.uint8],
        goals: npt.NDArray[np.float32],
        previous: npt.NDArray[Any],
        recurrent: npt.NDArray[np.float32],
    ) -> PolicyOutput:
        """Returns actions and termination probabilities; arguments as in `Policy.step`."""
        actions, termination, state = self._network(
            self._network.codebook(self._tensor(frames))[:, None],
            self._tensor(goals),
            self._tensor(previous)[:, None],
            self._lstm_state(recurrent),
        )
        chosen = actions.argmax(dim=3) if self.spec.action.choices else actions.clamp(-1, 1)  # (B, 1, A)
        return PolicyOutput(
            actions=chosen.cpu().numpy(),
            reached=termination[:, 0].sigmoid().cpu().numpy(),
            recurrent=flat_lstm_state(state),
        )
