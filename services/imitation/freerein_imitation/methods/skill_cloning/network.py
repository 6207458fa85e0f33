"""Behaviour-cloned skill policies of section 2.4 as one network: features of recent frames, scaled by the skill.

Nothing is assumed of robot or scene: frames may be gray and actions torques, which need velocities, and so earlier
frames. A chunk of actions is predicted at once (Zhao et al., 2023), and whether the skill has ended.

The dissertation's policies see images alone. For a user's robot, its own state may be among the features of a timestep.
"""

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor, nn
from torch.nn import functional

from freerein.config import bounded, one_of
from freerein.errors import InvalidInput
from freerein.learning.encoders import ENCODERS, CameraEncoders, FrameTensors
from freerein.learning.image_statistics import statistics_sizes
from freerein.learning.in_distribution import InDistribution
from freerein.learning.inputs import InputSpec
from freerein_imitation.methods.shared import action_bins
from freerein_imitation.methods.skill_cloning.memory import MemorySizes
from freerein_imitation.model.torch_policy import PolicyNetwork, confidence

_DEPTH = 3
_MOTION_CONTRAST = 4.0  # of differences of features
_LEAST_STD = 0.02  # of actions, in [-1, 1]
_LEAST_VARIATION = 1e-6  # of a number of the robot's state, relative to its magnitude; less is a constant
_MOST_DEVIATION = 10.0  # of a number of the robot's state, in standard deviations
_MOST_STATE = 16_000  # numbers; the API's `state` has 64 KiB


@dataclass(frozen=True, kw_only=True)
class SkillCloningSpec(InputSpec):
    """Inputs, outputs and sizes of the network.

    Attributes:
        skills: Names of the skills.
        ends: End of a skill: by the termination `head`, or after a `budget` of steps alone.
        encoder: Image encoder.
        features: Image features per camera.
        hidden_size: Units of the hidden layers.
        memory: Earlier frames that an action depends on.
        past_actions: Executed actions that an action depends on.
        chunk: Actions that are predicted from one frame.
        robot_state_size: S, numbers of the robot's own state; 0 for a network that takes none.

    Raises:
        InvalidInput: There are no skills, the memory is too large, or cameras or actions are out of bounds.
    """

    skills: tuple[str, ...]
    ends: Literal["head", "budget"] = "head"
    encoder: str = one_of(ENCODERS, "spatial")
    features: int = bounded(128, least=8, most=1024)
    hidden_size: int = bounded(256, least=8, most=1024)
    memory: int = bounded(2, least=0, most=16)
    past_actions: int = bounded(0, least=0, most=16)
    chunk: int = bounded(5, least=1, most=32)
    robot_state_size: int = bounded(0, least=0, most=1024)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.skills:
            raise InvalidInput("A policy must have at least 1 skill; got 0.", hint="Label the dataset with skills.")
        if self.memory_sizes.total > _MOST_STATE:
            raise InvalidInput(
                f"A policy's memory must have at most {_MOST_STATE} numbers; got {self.memory_sizes.total}.",
                field="config.memory",
                hint="Ask for fewer earlier frames, features or actions.",
            )

    @property
    def memory_sizes(self) -> MemorySizes:
        """Sizes of what it remembers; the features of a timestep are those of its frames, and the robot's state."""
        size, features = self.encoded_action_size, self.features * len(self.cameras) + self.robot_state_size
        return MemorySizes(self.memory, features, self.past_actions, size, self.chunk, outputs=size)


class SkillCloningNetwork(PolicyNetwork):
    """Encoder, hidden layers that the skill scales and shifts (FiLM; Perez et al., 2018), heads for chunk and end."""

    spec: SkillCloningSpec
    action_mean: Tensor
    action_std: Tensor
    robot_state_mean: Tensor
    robot_state_scale: Tensor

    def __init__(self, spec: SkillCloningSpec) -> None:
        super().__init__()
        self.spec = spec
        sizes, hidden = spec.memory_sizes, spec.hidden_size
        self.encoder = CameraEncoders(ENCODERS[spec.encoder], spec.cameras, features=spec.features)
        inputs = [(1 + sizes.frames) * sizes.features + sizes.actions * sizes.action_size, *[hidden] * (_DEPTH - 1)]
        self.layers = nn.ModuleList(nn.Linear(each, hidden) for each in inputs)
        self.film = nn.ModuleList(nn.Linear(len(spec.skills), 2 * hidden, bias=False) for _ in inputs)
        self.chunk_head = nn.Linear(hidden, sizes.chunk * sizes.outputs)
        self.termination_head = nn.Linear(hidden, 1)
        self.in_distribution = InDistribution(*statistics_sizes(spec.cameras))
        self.register_buffer("action_mean", torch.zeros(sizes.outputs))
        self.register_buffer("action_std", torch.ones(sizes.outputs))
        if spec.robot_state_size:  # others have the weights that they had before there was a state
            self.register_buffer("robot_state_mean", torch.zeros(spec.robot_state_size))
            self.register_buffer("robot_state_scale", torch.ones(spec.robot_state_size))
            self.robot_state_in_distribution = InDistribution(spec.robot_state_size)

    @torch.no_grad()
    def fit_normalisation(self, frames: FrameTensors, actions: Tensor, *, generator: torch.Generator) -> None:
        """Sets what is not trained: of the encoder, and mean and deviation of continuous actions.

        Args:
            frames: Some training frames, uint8 (N, H, W, C).
            actions: Executed ones, (M, A).
            generator: On the CPU.
        """
        self.encoder.fit_normalisation(frames, generator=generator)
        if not self.spec.action.choices:
            self.action_mean.copy_(actions.mean(dim=0))
            self.action_std.copy_(actions.std(dim=0, correction=0).clamp(min=_LEAST_STD))

    @torch.no_grad()
    def fit_robot_state(self, states: Tensor) -> None:
        """Sets mean and scale of the robot's state, float32 (M, S); numbers that do not vary are ignored: scale 0."""
        exact = states.double()
        mean, std = exact.mean(dim=0), exact.std(dim=0, correction=0)
        varies = std > _LEAST_VARIATION * exact.abs().amax(dim=0)
        self.robot_state_mean.copy_(mean)
        self.robot_state_scale.copy_(torch.where(varies, 1 / std, 0.0))

    def encode(self, frames: FrameTensors, robot_state: Tensor | None) -> Tensor:
        """Returns the features of timesteps, float32 (N, D).

        Args:
            frames: By camera, uint8 (N, H, W, C).
            robot_state: float32 (N, S); None where S is 0.
        """
        seen: Tensor = self.encoder(frames)
        if robot_state is None:
            return seen
        felt = self.standardised(robot_state).clamp(-_MOST_DEVIATION, _MOST_DEVIATION)
        return torch.cat([seen, felt], dim=1)

    def standardised(self, robot_state: Tensor) -> Tensor:
        """Returns states, float32 (N, S), in deviations from their mean; numbers that do not vary are 0."""
        return (robot_state - self.robot_state_mean) * self.robot_state_scale

    def confidence(self, ended: Tensor, robot_state: Tensor | None) -> Tensor:
        """Returns how sure answers are, float32 (N,): of the end, but no more than the state is like held-out ones.

        Args:
            ended: Probability that the skill has ended, float32 (N,).
            robot_state: float32 (N, S); None where S is 0.
        """
        sure = confidence(ended)
        if robot_state is None:
            return sure
        score = self.robot_state_in_distribution
        familiarity: Tensor = score(score.distance(self.standardised(robot_state)), torch.ones_like(sure))
        return torch.minimum(sure, familiarity)

    def forward(
        self, features: Tensor, skill: Tensor, earlier: Tensor, rates: Tensor, executed: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Returns standardised actions or logits of choices, float32 (B, K, O), and termination logits (B,).

        Args:
            features: Of the newest timestep, float32 (B, D), of `encode`.
            skill: One-hot, float32 (B, skills).
            earlier: Features of earlier timesteps, float32 (B, n, D), newest first.
            rates: Of each, 1 / timesteps to the next newer one, 0 for none, (B, n): in training, which ones there are.
            executed: Encoded actions executed before, float32 (B, m, E), newest first.
        """
        newer = torch.cat([features[:, None], earlier[:, :-1]], dim=1)[:, : earlier.shape[1]]
        motion = _MOTION_CONTRAST * (newer - earlier) * rates[..., None]  # (B, n, D)
        x = torch.cat([features, motion.flatten(1), executed.flatten(1)], dim=1)
        for layer, film in zip(self.layers, self.film, strict=True):
            scale, shift = film(skill).chunk(2, dim=1)
            x = functional.relu(layer(x) * (1 + scale) + shift)
        chunk: Tensor = self.chunk_head(x).unflatten(1, (self.spec.chunk, -1))
        return chunk, self.termination_head(x)[:, 0]

    def encode_actions(self, actions: Tensor) -> Tensor:
        """Returns actions, float32 (..., A) or int64 (..., 1), as the network predicts them: float32 (..., O).

        No action, 0 or -1 when discrete, may stand for an unknown one: it is zeros where discrete.
        """
        if self.spec.action.choices:
            return action_bins.encode(actions, choices=self.spec.action.choices)[..., 0, :]
        return (actions - self.action_mean) / self.action_std
