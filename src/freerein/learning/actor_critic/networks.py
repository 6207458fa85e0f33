"""Actor and critic with a shared image encoder, or a frozen object encoder, and optionally a shared LSTM."""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from freerein.config import bounded, one_of
from freerein.errors import InvalidInput
from freerein.learning.actor_critic.distributions import Categorical, Distribution, Gaussian
from freerein.learning.actor_critic.frame_stack import luma, stack_frames
from freerein.learning.actor_critic.object_encoder import ObjectEncoder, ObjectEncoderSpec
from freerein.learning.encoders import ENCODERS
from freerein.learning.encoders.encoder import Encoder

_HIDDEN_GAIN = 2**0.5
_ACTOR_GAIN, _CRITIC_GAIN = 0.01, 1.0

_STATE_BYTES, _HEADER_BYTES = 64 * 1024, 64
"""Size of a served policy's `state`, and of what it has beside the policy's memory."""


@dataclass(frozen=True, kw_only=True)
class ActorCriticSpec:
    """Observations, actions and sizes of a network.

    Attributes:
        action_size: Numbers per action.
        action_choices: Number of discrete actions, 0 if continuous.
        vector_size: Numbers per vector observation, 0 for frames.
        height: Frame height in pixels; unused for vectors, as are width, channels and feature_size.
        width: Frame width in pixels.
        channels: Of a camera's frame, 1 or 3.
        cameras: Number of cameras; their frames, of one size, are side by side on the channels.
        frame_stack: k, the last frames of each camera that are one observation, on the channels.
        gray: Whether the network sees the luma of RGB frames.
        feature_size: Image features.
        hidden_size: Units per hidden layer, and of the LSTM.
        recurrent: Whether there is an LSTM.
        init_log_std: Initial log standard deviation of continuous actions.
        layer_norm: Whether each hidden layer is normalised.
        eye: The frozen object encoder that sees the frames; None for an image encoder that is trained.
        action_repeat: Timesteps that each action is held for, by whoever acts with the policy.
        encoder: Image encoder; unused for vectors and with an object encoder.

    Raises:
        InvalidInput: There are 2 channels, or a discrete action has more than one number, or an object encoder has not
            one RGB frame of one camera and continuous actions, or vectors are to be stacked, or the frames of a stack
            do not fit into a served policy's `state`.
    """

    action_size: int = bounded(1, least=1, most=256)
    action_choices: int = bounded(0, least=0, most=4096)
    vector_size: int = bounded(0, least=0, most=4096)
    height: int = bounded(64, least=4, most=1024)
    width: int = bounded(64, least=4, most=1024)
    channels: int = bounded(3, least=1, most=3)
    cameras: int = bounded(1, least=1, most=8)
    frame_stack: int = bounded(1, least=1, most=16)
    gray: bool = False
    feature_size: int = bounded(128, least=8, most=1024)
    hidden_size: int = bounded(64, least=2, most=1024)
    recurrent: bool = False
    init_log_std: float = bounded(-0.5, least=-5.0, most=2.0)
    layer_norm: bool = False
    eye: ObjectEncoderSpec | None = None
    action_repeat: int = bounded(1, least=1, most=16)
    encoder: str = one_of(ENCODERS, "spatial")

    def __post_init__(self) -> None:
        if self.channels == 2:
            raise InvalidInput("Frames must have 1 or 3 channels; got 2.", hint="Render frames as gray or RGB.")
        if self.vector_size and self.frame_stack > 1:
            raise InvalidInput(
                f"Frames are stacked, not vectors; got a stack of {self.frame_stack} vectors.",
                field="config.frame_stack",
                hint="Observe a camera, or use a recurrent policy.",
            )
        sees_one_frame = (self.channels, self.cameras, self.frame_stack, self.gray) == (3, 1, 1, False)
        if self.eye is not None and (not sees_one_frame or self.vector_size or self.action_choices):
            raise InvalidInput(
                "An object encoder needs one RGB frame of one camera and continuous actions; got "
                f"{self.frame_stack} of {self.cameras}, {self.channels} channels and {self.action_choices} choices.",
                field="config.encoder",
                hint="Choose the encoder `spatial`.",
            )
        if self.frame_stack > 1 and self._state_bytes > _STATE_BYTES:
            raise InvalidInput(
                f"The {self.frame_stack - 1} earlier frames of a stack must fit into a served policy's `state` of "
                f"{_STATE_BYTES} bytes; it would need {self._state_bytes}.",
                field="config.frame_stack",
                hint="Stack fewer or smaller frames, or gray ones: --set gray=true --set height=48 --set width=48",
            )
        if self.action_choices and self.action_size > 1:
            raise InvalidInput(
                f"A discrete action must be one number; got {self.action_size}.", hint="Number the combinations."
            )

    @property
    def input_shape(self) -> tuple[int, ...]:
        """Shape of what an environment returns, the frames of all cameras or a vector: (H, W, C) or (D,)."""
        return (self.vector_size,) if self.vector_size else (self.height, self.width, self.channels * self.cameras)

    @property
    def observation_shape(self) -> tuple[int, ...]:
        """Shape of one observation, with the frames of a stack: (H, W, C) or (D,)."""
        shape = (self.height, self.width, self._frame_channels * self.frame_stack)
        return (self.vector_size,) if self.vector_size else shape

    @property
    def earlier_shape(self) -> tuple[int, ...]:
        """Shape of the earlier frames of a stack, (H, W, C * (k - 1)); (0,) for vectors."""
        shape = (self.height, self.width, self._frame_channels * (self.frame_stack - 1))
        return (0,) if self.vector_size else shape

    @property
    def recurrent_size(self) -> int:
        """Size of the recurrent state, hidden state and cell together; 0 without LSTM."""
        return 2 * self.hidden_size if self.recurrent else 0

    @property
    def _frame_channels(self) -> int:
        """Channels of the frames of one moment, as the network sees them."""
        return self.cameras * (1 if self.gray else self.channels)

    @property
    def _state_bytes(self) -> int:
        """Size of a served policy's `state`: a byte per pixel, and floats for the LSTM, the held action and counts."""
        return _HEADER_BYTES + 4 * (self.recurrent_size + self.action_size) + math.prod(self.earlier_shape)


@dataclass(frozen=True, eq=False)
class ActorCriticOutput:
    """Output of the network for T timesteps of B environments.

    Attributes:
        actions: Action distributions (T, B).
        values: float32 (T, B).
        recurrent_state: After the last timestep, float32 (B, recurrent_size).
    """

    actions: Distribution
    values: Tensor
    recurrent_state: Tensor


class ActorCritic(nn.Module):
    """Image encoder or object encoder, optional LSTM, and an actor and a critic of two hidden layers each.

    With an object encoder, observations are vectors: the features of a frame, and the last action, since bodies have
    momentum.

    Args:
        spec: Observations, actions and sizes.
    """

    def __init__(self, spec: ActorCriticSpec) -> None:
        super().__init__()
        self.spec = spec
        self.eye = None if spec.eye is None else _object_encoder(spec, spec.eye)
        self.image = None if spec.vector_size or spec.eye is not None else _image_encoder(spec)
        features = spec.vector_size or spec.feature_size
        if self.eye is not None:
            features = self.eye.size + spec.action_size
        self.lstm = nn.LSTM(features, spec.hidden_size) if spec.recurrent else None
        inputs = spec.hidden_size if spec.recurrent else features
        outputs = spec.action_choices or spec.action_size
        self.actor = _mlp(inputs, outputs, spec, gain=_ACTOR_GAIN)
        self.critic = _mlp(inputs, 1, spec, gain=_CRITIC_GAIN)
        self.gaussian = None if spec.action_choices else _DiagonalGaussian(spec.action_size, spec.init_log_std)

    def calibrate(self, observations: Tensor) -> None:
        """Calibrates the image encoder on frames uint8 (N, H, W, C); does nothing for vectors."""
        if self.image is not None:
            cast(Encoder, self.image).fit_normalisation(observations, generator=torch.Generator())

    @torch.no_grad()
    def set_log_std(self, log_std: float) -> None:
        """Sets the log standard deviation of continuous actions; does nothing for discrete ones."""
        if self.gaussian is not None:
            self.gaussian.log_std.fill_(log_std)

    @torch.no_grad()
    def observe(self, seen: Tensor, last_actions: Tensor, earlier: Tensor, starts: Tensor) -> Tensor:
        """Returns observations of N environments as `forward` takes them, on the CPU.

        Args:
            seen: Observations of environments, uint8 (N, H, W, C) or float32 (N, D).
            last_actions: Executed before, float32 (N, A), 0 where an episode starts; only read with an object encoder.
            earlier: Frames before it, from `earlier_frames`; not read where an episode starts.
            starts: Whether an episode starts with it, bool (N,).
        """
        if self.eye is not None:
            if seen.shape[0] == 0:  # the final ones of a step after which no episode ended
                return torch.zeros(0, self.eye.size + self.spec.action_size)
            features = self.eye(seen.to(self.eye.grasp.device)).cpu()
            return torch.cat([features, last_actions], dim=1)
        is_coloured = self.spec.gray and self.spec.channels == 3
        return stack_frames(luma(seen) if is_coloured else seen, earlier, starts)

    def earlier_frames(self, observations: Tensor) -> Tensor:
        """Returns the frames that the next observation stacks, (N, *earlier_shape), given those of `observe`."""
        if self.spec.frame_stack == 1:
            shape = (observations.shape[0], *self.spec.earlier_shape)
            return torch.zeros(shape, dtype=torch.uint8, device=observations.device)
        return observations[..., -self.spec.earlier_shape[-1] :]

    def forward(self, observations: Tensor, episode_starts: Tensor, recurrent_state: Tensor) -> ActorCriticOutput:
        """Returns action distributions and values of T timesteps of B environments.

        Args:
            observations: From `observe`, uint8 (T, B, H, W, C) or float32 (T, B, D).
            episode_starts: bool (T, B); the recurrent state is reset there.
            recurrent_state: Before the first timestep, float32 (B, recurrent_size).
        """
        features = observations
        if self.image is not None:
            features = self.image(observations.flatten(end_dim=1)).unflatten(0, episode_starts.shape)  # (T, B, F)
        if self.lstm is not None:
            features, recurrent_state = _run_lstm(self.lstm, features, episode_starts, recurrent_state)  # (T, B, H)
        scores = self.actor(features)  # (T, B, action_choices or action_size)
        actions = (
            Categorical(functional.log_softmax(scores, dim=-1)) if self.gaussian is None else self.gaussian(scores)
        )
        return ActorCriticOutput(actions, self.critic(features)[..., 0], recurrent_state)


def _image_encoder(spec: ActorCriticSpec) -> nn.Module:
    height, width, channels = spec.observation_shape
    return ENCODERS[spec.encoder](height=height, width=width, channels=channels, features=spec.feature_size)


def _object_encoder(spec: ActorCriticSpec, objects: ObjectEncoderSpec) -> ObjectEncoder:
    return ObjectEncoder(objects, height=spec.height, width=spec.width, action_size=spec.action_size)


def _run_lstm(lstm: nn.LSTM, features: Tensor, starts: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
    """Returns an LSTM's outputs (T, B, hidden) and its state after them, (B, 2 * hidden).

    Consecutive timesteps without an episode start share one call.
    """
    hidden, cell = state[None].chunk(2, dim=-1)  # (1, B, hidden) each
    splits = (starts[1:].any(dim=1).nonzero()[:, 0] + 1).tolist() if len(starts) > 1 else []
    outputs = []
    for begin, end in pairwise([0, *splits, len(starts)]):
        keep = (~starts[begin]).float()[None, :, None]  # (1, B, 1)
        output, (hidden, cell) = lstm(features[begin:end], (hidden * keep, cell * keep))
        outputs.append(output)
    return torch.cat(outputs), torch.cat([hidden, cell], dim=-1)[0]


def _mlp(inputs: int, outputs: int, spec: ActorCriticSpec, *, gain: float) -> nn.Sequential:
    layers: list[nn.Module] = []
    for size in (inputs, spec.hidden_size):
        layers.append(_OrthogonalLinear(size, spec.hidden_size, gain=_HIDDEN_GAIN))
        if spec.layer_norm:
            layers.append(nn.LayerNorm(spec.hidden_size))
        layers.append(nn.Tanh())
    return nn.Sequential(*layers, _OrthogonalLinear(spec.hidden_size, outputs, gain=gain))


class _OrthogonalLinear(nn.Linear):
    """A linear layer with orthogonal initial weights and zero bias."""

    def __init__(self, inputs: int, outputs: int, *, gain: float) -> None:
        super().__init__(inputs, outputs)
        self._gain = gain

    def initialise(self, generator: torch.Generator) -> None:
        """Initialises the weights."""
        nn.init.orthogonal_(self.weight, self._gain, generator=generator)
        nn.init.zeros_(self.bias)


class _DiagonalGaussian(nn.Module):
    """Turns means into Gaussians whose standard deviation is the same in every state."""

    def __init__(self, size: int, init_log_std: float) -> None:
        super().__init__()
        self._init_log_std = init_log_std
        self.log_std = nn.Parameter(torch.empty(size))

    def initialise(self, generator: torch.Generator) -> None:  # nothing random
        """Initialises the standard deviation."""
        nn.init.constant_(self.log_std, self._init_log_std)

    def forward(self, mean: Tensor) -> Gaussian:
        """Returns the distributions around means float32 (..., A)."""
        return Gaussian(mean, self.log_std)
