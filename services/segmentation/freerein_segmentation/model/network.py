"""The segmentation network: a CNN per frame, a layer per action, an LSTM over time, a score per skill (section 2.3)."""

from dataclasses import dataclass
from typing import Literal, TypeAlias

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.utils.rnn import pad_sequence

from freerein.errors import InvalidInput
from freerein.learning.config import bounded
from freerein.learning.encoders import PatchEncoder

Context: TypeAlias = Literal["causal", "bidirectional"]

_ACTION_FEATURES = 32
_TIMESTEPS_AT_ONCE = 1024


@dataclass(frozen=True, kw_only=True)
class ModelSpec:
    """What a network labels, what it sees, and how large it is.

    Attributes:
        skills: What it labels.
        camera: Which camera's frames it sees.
        height: Of the frames, in pixels.
        width: In pixels.
        channels: 1 or 3.
        action_size: Numbers per action; 0 for a network that sees no actions.
        action_choices: How many different actions there are when they are discrete, else 0.
        stride: Timesteps from one that the LSTM sees to the next; timesteps in between belong to passes of their own.
        context: What a timestep's score may depend on: the past, as in the dissertation, or all of the trajectory.
        features: Image features.
        hidden: Units of the LSTM, in each direction.

    Raises:
        InvalidInput: There are no skills, or 2 channels.
    """

    skills: tuple[str, ...]
    camera: str
    height: int = bounded(64, least=4, most=1024)
    width: int = bounded(64, least=4, most=1024)
    channels: int = bounded(3, least=1, most=3)
    action_size: int = bounded(0, least=0, most=256)
    action_choices: int = bounded(0, least=0, most=4096)
    stride: int = bounded(1, least=1, most=100)
    context: Context = "bidirectional"
    features: int = bounded(64, least=8, most=1024)
    hidden: int = bounded(100, least=8, most=1024)

    def __post_init__(self) -> None:
        if not self.skills or self.channels == 2:
            raise InvalidInput(
                f"A network must label at least 1 skill and see 1 or 3 channels; "
                f"got {len(self.skills)} skills and {self.channels} channels.",
                hint="Tag the trajectories, and store frames as gray or RGB.",
            )


class SegmentationNetwork(nn.Module):
    """f_t(k), eq. 2.1: a score for each skill at each timestep; softmax over k gives P(y_t = k).

    Args:
        spec: What it labels and sees.
    """

    def __init__(self, spec: ModelSpec) -> None:
        super().__init__()
        self.spec = spec
        self.image = PatchEncoder(height=spec.height, width=spec.width, channels=spec.channels, features=spec.features)
        self.action = nn.Linear(spec.action_choices or spec.action_size, _ACTION_FEATURES) if spec.action_size else None
        inputs = spec.features + (_ACTION_FEATURES if spec.action_size else 0)
        self.past = nn.LSTM(inputs, spec.hidden, batch_first=True)
        self.future = nn.LSTM(inputs, spec.hidden, batch_first=True) if spec.context == "bidirectional" else None
        self.head = nn.Linear(spec.hidden * (2 if self.future else 1), len(spec.skills))

    def forward(self, frames: Tensor, actions: Tensor, lengths: Tensor) -> tuple[Tensor, Tensor]:
        """Returns the scores of several trajectories, and which of them are of timesteps that exist.

        Args:
            frames: uint8 (N, H, W, C), the frames of all trajectories one after the other.
            actions: float32 (N, A) or int64 (N, 1), as the frames.
            lengths: int64 (B,), the timesteps of each trajectory, N together.

        Returns:
            Scores, float32 (B, T, K) with T the longest length, and their mask, bool (B, T).
        """
        features, ends = self.features(frames, actions), lengths.cumsum(dim=0).cpu()  # (N, D), (B,)
        padded = pad_sequence(list(features.tensor_split(ends[:-1])), batch_first=True)  # (B, T, D)
        time = torch.arange(padded.shape[1], device=padded.device)  # (T,)
        memory, _ = self.past(padded)  # (B, T, hidden)
        if self.future is not None:
            # Reversed within each length, so that padding comes last here, too.
            mirror = (lengths[:, None] - 1 - time).clamp(min=0)[:, :, None]  # (B, T, 1)
            reversed_memory, _ = self.future(padded.gather(1, mirror.expand_as(padded)))  # (B, T, hidden)
            ahead = reversed_memory.gather(1, mirror.expand_as(reversed_memory))
            memory = torch.cat([memory, ahead], dim=2)  # (B, T, 2 hidden)
        scores: Tensor = self.head(memory)  # (B, T, K)
        return scores, time < lengths[:, None]

    def features(self, frames: Tensor, actions: Tensor) -> Tensor:
        """Returns what the LSTM sees, float32 (N, D), of frames uint8 (N, H, W, C) and actions (N, A)."""
        seen: Tensor = self.image(frames)  # (N, features)
        if self.action is None:
            return seen
        if self.spec.action_choices:
            actions = functional.one_hot(actions[:, 0], self.spec.action_choices).to(seen.dtype)  # (N, choices)
        return torch.cat([seen, functional.relu(self.action(actions))], dim=1)  # (N, D)

    def score(self, features: Tensor) -> Tensor:
        """Returns the scores (T, K) of one trajectory's features (T, D), as `forward` does, whatever T.

        The LSTM runs a window at a time and carries its state, so that memory beyond in- and output does not grow.
        """
        memory = _run(self.past, features)  # (T, hidden)
        if self.future is not None:
            memory = torch.cat([memory, _run(self.future, features.flip(0)).flip(0)], dim=1)  # (T, 2 hidden)
        scores: Tensor = self.head(memory)
        return scores


def _run(lstm: nn.LSTM, features: Tensor) -> Tensor:
    state, memory = None, []
    for start in range(0, len(features), _TIMESTEPS_AT_ONCE):
        output, state = lstm(features[start : start + _TIMESTEPS_AT_ONCE], state)  # (T, hidden)
        memory.append(output)
    return torch.cat(memory)
