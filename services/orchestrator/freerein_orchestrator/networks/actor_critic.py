"""An actor and a critic that share their eyes and, where there is one, their memory."""

from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

from freerein.errors import InvalidInput
from freerein.learning.config import bounded
from freerein.learning.encoders import SpatialEncoder
from freerein_orchestrator.networks.distributions import Categorical, Distribution, Gaussian

_HIDDEN_GAIN = 2**0.5
_ACTOR_GAIN, _CRITIC_GAIN = 0.01, 1.0


@dataclass(frozen=True, kw_only=True)
class ActorCriticSpec:
    """What the networks see and do, and how large they are.

    Attributes:
        action_size: Numbers per action.
        action_choices: How many different actions there are when they are discrete, else 0.
        vector_size: Numbers per observation when it is a vector, else 0.
        height: Of the frames, in pixels; of no meaning for vectors, as are width, channels and features.
        width: In pixels.
        channels: 1 or 3.
        features: Image features.
        hidden: Units of each hidden layer, and of the memory.
        is_recurrent: Whether there is a memory, an LSTM.
        log_std: Of continuous actions, before the first update.

    Raises:
        InvalidInput: There are 2 channels, or a discrete action has more than one number.
    """

    action_size: int = bounded(1, least=1, most=256)
    action_choices: int = bounded(0, least=0, most=4096)
    vector_size: int = bounded(0, least=0, most=4096)
    height: int = bounded(64, least=4, most=1024)
    width: int = bounded(64, least=4, most=1024)
    channels: int = bounded(3, least=1, most=3)
    features: int = bounded(128, least=8, most=1024)
    hidden: int = bounded(64, least=2, most=1024)
    is_recurrent: bool = False
    log_std: float = bounded(-0.5, least=-5.0, most=2.0)

    def __post_init__(self) -> None:
        if self.channels == 2:
            raise InvalidInput("Frames must have 1 or 3 channels; got 2.", hint="Render frames as gray or RGB.")
        if self.action_choices and self.action_size > 1:
            raise InvalidInput(
                f"A discrete action must be one number; got {self.action_size}.", hint="Number the combinations."
            )

    @property
    def observation_shape(self) -> tuple[int, ...]:
        """Shape of one observation: (H, W, C) of a frame, (D,) of a vector."""
        return (self.vector_size,) if self.vector_size else (self.height, self.width, self.channels)

    @property
    def memory_size(self) -> int:
        """Numbers that are remembered from one timestep to the next."""
        return 2 * self.hidden if self.is_recurrent else 0


@dataclass(frozen=True, eq=False)
class Outputs:
    """What the networks make of T timesteps of B environments.

    Attributes:
        actions: What to do, over (T, B).
        values: The discounted sum of rewards that is expected, float32 (T, B).
        memory: After the last timestep, float32 (B, memory_size).
    """

    actions: Distribution
    values: Tensor
    memory: Tensor


class ActorCritic(nn.Module):
    """A policy and its value: an encoder, perhaps an LSTM, and two towers of two hidden layers each.

    Args:
        spec: What they see and do.
    """

    def __init__(self, spec: ActorCriticSpec) -> None:
        super().__init__()
        self.spec = spec
        self.image = None if spec.vector_size else _image_encoder(spec)
        features = spec.vector_size or spec.features
        self.lstm = nn.LSTM(features, spec.hidden) if spec.is_recurrent else None
        inputs = spec.hidden if spec.is_recurrent else features
        self.actor = _tower(inputs, spec.hidden, spec.action_choices or spec.action_size, gain=_ACTOR_GAIN)
        self.critic = _tower(inputs, spec.hidden, 1, gain=_CRITIC_GAIN)
        self.spread = None if spec.action_choices else _Spread(spec.action_size, spec.log_std)

    def calibrate(self, observations: Tensor) -> None:
        """Takes the mean image, and the deviation from it, from frames uint8 (N, H, W, C); vectors stay as they are."""
        if self.image is not None:
            self.image.fit_normalisation(observations)

    def forward(self, observations: Tensor, starts: Tensor, memory: Tensor) -> Outputs:
        """Returns what to do at T timesteps of B environments, one after the other, and what it is worth.

        Args:
            observations: uint8 (T, B, H, W, C) or float32 (T, B, D).
            starts: bool (T, B), whether an episode begins there; nothing is remembered from before.
            memory: Before the first timestep, float32 (B, memory_size).
        """
        features = observations
        if self.image is not None:
            features = self.image(observations.flatten(end_dim=1)).unflatten(0, starts.shape)  # (T, B, features)
        if self.lstm is not None:
            features, memory = _remember(self.lstm, features, starts, memory)  # (T, B, hidden)
        scores = self.actor(features)  # (T, B, action_choices or action_size)
        actions = Categorical(functional.log_softmax(scores, dim=-1)) if self.spread is None else self.spread(scores)
        return Outputs(actions, self.critic(features)[..., 0], memory)


def _image_encoder(spec: ActorCriticSpec) -> SpatialEncoder:
    return SpatialEncoder(height=spec.height, width=spec.width, channels=spec.channels, features=spec.features)


def _remember(lstm: nn.LSTM, features: Tensor, starts: Tensor, memory: Tensor) -> tuple[Tensor, Tensor]:
    """Returns an LSTM's outputs (T, B, hidden) and its memory thereafter, (B, 2 * hidden).

    Timesteps at which no environment begins an episode are passed in one call with those before them.
    """
    hidden, cell = memory[None].chunk(2, dim=-1)  # (1, B, hidden) each
    cuts = (starts[1:].any(dim=1).nonzero()[:, 0] + 1).tolist()
    outputs = []
    for begin, end in pairwise([0, *cuts, len(starts)]):
        keep = (~starts[begin]).float()[None, :, None]  # (1, B, 1)
        output, (hidden, cell) = lstm(features[begin:end], (hidden * keep, cell * keep))
        outputs.append(output)
    return torch.cat(outputs), torch.cat([hidden, cell], dim=-1)[0]


def _tower(inputs: int, hidden: int, outputs: int, *, gain: float) -> nn.Sequential:
    return nn.Sequential(
        _Orthogonal(inputs, hidden, gain=_HIDDEN_GAIN),
        nn.Tanh(),
        _Orthogonal(hidden, hidden, gain=_HIDDEN_GAIN),
        nn.Tanh(),
        _Orthogonal(hidden, outputs, gain=gain),
    )


class _Orthogonal(nn.Linear):
    """A layer whose first weights are orthogonal: a small gain makes the first policy indifferent between actions."""

    def __init__(self, inputs: int, outputs: int, *, gain: float) -> None:
        super().__init__(inputs, outputs)
        self._gain = gain

    def initialise(self, generator: torch.Generator) -> None:
        """Draws the first weights."""
        nn.init.orthogonal_(self.weight, self._gain, generator=generator)
        nn.init.zeros_(self.bias)


class _Spread(nn.Module):
    """How far continuous actions stray from their mean, learnt, and the same in every state."""

    def __init__(self, size: int, log_std: float) -> None:
        super().__init__()
        self._first = log_std
        self.log_std = nn.Parameter(torch.empty(size))

    def initialise(self, generator: torch.Generator) -> None:  # nothing is left to chance here
        """Sets the first spread."""
        nn.init.constant_(self.log_std, self._first)

    def forward(self, mean: Tensor) -> Gaussian:
        """Returns the distribution around means float32 (..., A)."""
        return Gaussian(mean, self.log_std)
