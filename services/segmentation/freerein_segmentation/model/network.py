"""The segmentation network: a CNN per frame, a dense layer per action, an LSTM over time (section 2.3)."""

from dataclasses import dataclass
from typing import Literal, TypeAlias

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.utils.rnn import pad_sequence

from freerein.config import bounded, bounded_or_all, one_of
from freerein.errors import InvalidInput
from freerein.learning.action_scaling import ActionScaling
from freerein.learning.encoders import ENCODERS, CameraEncoders, FrameTensors
from freerein.learning.image_statistics import image_statistics, statistics_sizes
from freerein.learning.in_distribution import InDistribution
from freerein.learning.inputs import InputSpec
from freerein_segmentation.model.lookahead import MAX_CONTEXT, Context, countdown, look_ahead

Memory: TypeAlias = tuple[Tensor, Tensor]
"""State of an LSTM over one sequence, float (1, H) each."""

_ACTION_FEATURES = 32
_TIMESTEPS_AT_ONCE = 1024


@dataclass(frozen=True, kw_only=True)
class ModelSpec(InputSpec):
    """Architecture of a segmentation network.

    Attributes:
        skills: Names of the skills.
        use_actions: Whether executed actions are an input.
        action_scaling: How actions in the robot's own unit are scaled; None for actions in [-1, 1] and discrete ones.
        encoder: Image encoder.
        stride: Temporal stride of the LSTM; the timesteps of each phase are a sequence of their own.
        context: Future timesteps of such a sequence that its scores depend on, or `all`; 0 is the dissertation's.
        features: Number of image features per camera.
        hidden_size: LSTM units per direction.
        scores_colours: Whether the in-distribution score sees colourfulness, too; not in models of before.

    Raises:
        InvalidInput: There are no skills or several cameras, or frames or actions are out of bounds.
    """

    skills: tuple[str, ...]
    use_actions: bool = True
    action_scaling: ActionScaling | None = None
    encoder: str = one_of(ENCODERS, "patch")
    stride: int = bounded(1, least=1, most=100)
    context: int | Literal["all"] = bounded_or_all("all", least=0, most=MAX_CONTEXT)
    features: int = bounded(64, least=8, most=1024)
    hidden_size: int = bounded(100, least=8, most=1024)
    scores_colours: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.cameras) != 1:
            raise InvalidInput(
                f"`cameras` must name 1 camera, because a request's frames are of one; got {len(self.cameras)}.",
                field="config.cameras",
                hint=f"Name one of them: --set cameras={self.cameras[0].name}.",
            )
        if not self.skills:
            raise InvalidInput("A network needs at least 1 skill; got 0.", hint="Tag the trajectories.")

    def scaled(self, actions: Tensor) -> Tensor:
        """Returns continuous actions (N, A) about in [-1, 1], and others as they are."""
        return self.action_scaling.scaled(actions) if self.action_scaling else actions


class SegmentationNetwork(nn.Module):
    """Scores f_t(k), eq. 2.1, of each skill at each timestep; softmax over k gives P(y_t = k)."""

    def __init__(self, spec: ModelSpec) -> None:
        super().__init__()
        self.spec = spec
        self.image = CameraEncoders(ENCODERS[spec.encoder], spec.cameras, features=spec.features)
        self.action = nn.Linear(spec.encoded_action_size, _ACTION_FEATURES) if spec.use_actions else None
        inputs = self.image.size + (_ACTION_FEATURES if spec.use_actions else 0)
        self.past = nn.LSTM(inputs, spec.hidden_size, batch_first=True)
        self.future = nn.LSTM(inputs, spec.hidden_size, batch_first=True) if spec.context else None
        self.head = nn.Linear(spec.hidden_size * (2 if self.future else 1), len(spec.skills))
        self.in_distribution = InDistribution(*statistics_sizes(spec.cameras, colours=spec.scores_colours))

    def forward(
        self, frames: FrameTensors, actions: Tensor, lengths: Tensor, *, context: Context | None = None
    ) -> tuple[Tensor, Tensor]:
        """Returns padded scores, float32 (B, T, K), and their mask, bool (B, T), of several trajectories.

        Args:
            frames: By camera, uint8 (N, H, W, C), all trajectories concatenated.
            actions: float32 (N, A) or int64 (N, 1), likewise.
            lengths: int64 (B,), timesteps of each trajectory, with sum N.
            context: Future timesteps that these scores depend on, where they are fewer than the network's.
        """
        return self.score_batch(self.features(frames, actions), lengths, context=context)

    def score_batch(
        self, features: Tensor, lengths: Tensor, *, context: Context | None = None
    ) -> tuple[Tensor, Tensor]:
        """Returns what `forward` does, of features (N, D)."""
        context = self.spec.context if context is None else context
        ends = lengths.cumsum(dim=0)  # (B,)
        padded = _padded(features, ends)  # (B, T, D)
        time = torch.arange(padded.shape[1], device=padded.device)  # (T,)
        memory, _ = self.past(padded)  # (B, T, hidden_size)
        if self.future is not None:
            if not isinstance(context, int):
                # Reversed within each length, so that padding stays last.
                mirror = (lengths[:, None] - 1 - time).clamp(min=0)[:, :, None]  # (B, T, 1)
                reversed_memory, _ = self.future(padded.gather(1, mirror.expand_as(padded)))  # (B, T, hidden_size)
                ahead = reversed_memory.gather(1, mirror.expand_as(reversed_memory))
            else:
                remaining = countdown(features) - (ends[-1] - ends).repeat_interleave(lengths)  # (N,)
                ahead = _padded(look_ahead(self.future, features, remaining, context=context), ends)
            memory = torch.cat([memory, ahead], dim=2)  # (B, T, 2 hidden_size)
        scores: Tensor = self.head(memory)  # (B, T, K)
        return scores, time < lengths[:, None]

    def features(self, frames: FrameTensors, actions: Tensor) -> Tensor:
        """Returns the LSTM's inputs, float32 (N, D), of frames uint8 (N, H, W, C) by camera, and actions (N, A)."""
        seen: Tensor = self.image(frames)  # (N, cameras * features)
        if self.action is None:
            return seen
        if self.spec.action.choices:
            actions = functional.one_hot(actions[:, 0], self.spec.action.choices).to(seen.dtype)  # (N, choices)
        return torch.cat([seen, functional.relu(self.action(self.spec.scaled(actions)))], dim=1)  # (N, D)

    def statistics(self, frames: FrameTensors) -> Tensor:
        """Returns the in-distribution score's inputs, float32 (N, D), of frames uint8 (N, H, W, C) by camera."""
        return image_statistics(frames, colours=self.spec.scores_colours)

    def score(self, features: Tensor) -> Tensor:
        """Returns the scores (T, K) of one trajectory's features (T, D), as `forward` does.

        The LSTM runs window by window and carries its state, so that working memory is bounded.
        """
        memory, _ = run(self.past, features)  # (T, hidden_size)
        if self.future is not None:
            if not isinstance(self.spec.context, int):
                ahead = run(self.future, features.flip(0))[0].flip(0)
            else:
                ahead = look_ahead(self.future, features, countdown(features), context=self.spec.context)
            memory = torch.cat([memory, ahead], dim=1)  # (T, 2 hidden_size)
        scores: Tensor = self.head(memory)
        return scores


def run(lstm: nn.LSTM, features: Tensor, state: Memory | None = None) -> tuple[Tensor, Memory | None]:
    """Returns the output (T, H) of an LSTM over features (T, D) after a state, and the state after them."""
    memory = [features.new_zeros(0, lstm.hidden_size)]
    for start in range(0, len(features), _TIMESTEPS_AT_ONCE):
        output, state = lstm(features[start : start + _TIMESTEPS_AT_ONCE], state)  # (T, hidden_size)
        memory.append(output)
    return torch.cat(memory), state


def _padded(features: Tensor, ends: Tensor) -> Tensor:
    """Returns features (N, D) of concatenated trajectories, which end at `ends`, int64 (B,), as (B, T, D)."""
    return pad_sequence(list(features.tensor_split(ends[:-1].cpu())), batch_first=True)
