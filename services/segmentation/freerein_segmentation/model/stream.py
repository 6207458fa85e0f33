"""Predictions for a trajectory that arrives bit by bit, by a network whose context is finite."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freerein_segmentation.model.lookahead import countdown, look_ahead
from freerein_segmentation.model.network import Memory, SegmentationNetwork, run

FRAMES_AT_ONCE = 256

Encode = Callable[[npt.NDArray[np.uint8], npt.NDArray[Any]], tuple[Tensor, Tensor]]
"""Given frames (T, H, W, C) and actions (T, A), returns the LSTM's inputs (T, D) and distances (T,) of the frames."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """A model's output for T timesteps.

    Attributes:
        probabilities: P(y_t = k), eq. 2.1, float32 (T, K).
        in_distribution: How much each is like those on held-out data, float32 (T,) in [0, 1]; see
            `freerein.learning.in_distribution`.
    """

    probabilities: npt.NDArray[np.float32]
    in_distribution: npt.NDArray[np.float32]


class SegmentationStream:
    """Predicts timesteps as soon as their context was pushed; see `SegmentationModel.stream`.

    Together the predictions equal that of the whole trajectory, up to rounding. Memory does not grow with time.
    """

    def __init__(self, network: SegmentationNetwork, encode: Encode, *, context: int) -> None:
        stride = network.spec.stride
        self._phases = [_Phase(network, context) for _ in range(stride)]
        self._encode = encode
        self._lag = context * stride
        self._skills = len(network.spec.skills)
        self._pushed = 0
        self._finished = 0

    @torch.inference_mode()
    def push(self, frames: npt.NDArray[np.uint8], actions: npt.NDArray[Any] | None) -> Prediction:
        """Returns the prediction of the timesteps that these finish: all but the last `lag` pushed so far.

        Args:
            frames: uint8 (n, H, W, C), the next ones.
            actions: float32 (n, A) or int64 (n, 1), executed after them; not read by a model without actions.
        """
        if actions is None:
            actions = np.zeros((len(frames), 0), np.float32)
        parts = [self._empty(0)]
        for start in range(0, len(frames), FRAMES_AT_ONCE):
            at = slice(start, start + FRAMES_AT_ONCE)
            parts.append(self._push(*self._encode(frames[at], actions[at])))
        return Prediction(
            np.concatenate([each.probabilities for each in parts]),
            np.concatenate([each.in_distribution for each in parts]),
        )

    @torch.inference_mode()
    def finish(self) -> Prediction:
        """Returns the prediction of the other timesteps pushed so far, as if the trajectory ended here.

        The stream does not change, so that this is also a provisional prediction before more is pushed.
        """
        return self._merged([phase.finish() for phase in self._phases_from(self._finished)], stop=self._pushed)

    def _push(self, features: Tensor, distances: Tensor) -> Prediction:
        count = len(self._phases)
        for first, phase in enumerate(self._phases_from(self._pushed)):
            phase.push(features[first::count], distances[first::count])
        self._pushed += len(features)
        stop = max(self._finished, self._pushed - self._lag)
        merged = self._merged([phase.pop() for phase in self._phases_from(self._finished)], stop=stop)
        self._finished = stop
        return merged

    def _phases_from(self, timestep: int) -> list["_Phase"]:
        """Returns the phases in the order of the timesteps from one on."""
        first = timestep % len(self._phases)
        return self._phases[first:] + self._phases[:first]

    def _merged(self, parts: list[tuple[Tensor, Tensor]], *, stop: int) -> Prediction:
        """Returns timesteps from `_finished` to `stop`, of which each phase has every `stride`-th."""
        merged = self._empty(stop - self._finished)
        for first, (probabilities, scores) in enumerate(parts):
            merged.probabilities[first :: len(parts)] = probabilities.cpu().numpy()
            merged.in_distribution[first :: len(parts)] = scores.cpu().numpy()
        return merged

    def _empty(self, timesteps: int) -> Prediction:
        return Prediction(np.empty((timesteps, self._skills), np.float32), np.empty(timesteps, np.float32))


class _Phase:
    """The timesteps of one phase of the stride, which are a sequence of their own."""

    def __init__(self, network: SegmentationNetwork, context: int) -> None:
        self._network = network
        self._context = context
        self._state: Memory | None = None
        head = network.head.weight
        self._features = head.new_zeros(0, network.past.input_size)  # of timesteps that are not finished
        self._memory = head.new_zeros(0, network.past.hidden_size)
        self._distances = head.new_zeros(0)

    def push(self, features: Tensor, distances: Tensor) -> None:
        """Appends timesteps: features (n, D), distances (n,)."""
        memory, self._state = run(self._network.past, features, self._state)
        self._features = torch.cat([self._features, features])
        self._memory = torch.cat([self._memory, memory])
        self._distances = torch.cat([self._distances, distances])

    def pop(self) -> tuple[Tensor, Tensor]:
        """Returns probabilities (n, K) and scores (n,) of the timesteps whose context is complete, and forgets them."""
        count = max(0, len(self._features) - self._context)
        finished = self._predicted(count)
        self._features, self._memory = self._features[count:], self._memory[count:]
        self._distances = self._distances[count:]
        return finished

    def finish(self) -> tuple[Tensor, Tensor]:
        """Returns probabilities and scores of all other timesteps, with what context they have."""
        return self._predicted(len(self._features))

    def _predicted(self, count: int) -> tuple[Tensor, Tensor]:
        network, memory = self._network, self._memory[:count]
        if network.future is not None:
            remaining = countdown(self._features)[:count]
            ahead = look_ahead(network.future, self._features, remaining, context=self._context)
            memory = torch.cat([memory, ahead], dim=1)
        probabilities = network.head(memory).softmax(dim=1)
        return probabilities, network.in_distribution(self._distances[:count], probabilities.amax(dim=1))
