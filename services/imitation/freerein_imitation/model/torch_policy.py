"""The base of policies that are torch networks."""

from abc import abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from freerein.config import C
from freerein.learning import model_files
from freerein.learning.encoders import FrameTensors
from freerein.learning.image_statistics import image_statistics
from freerein.learning.in_distribution import InDistribution
from freerein.learning.inputs import InputSpec
from freerein.types.imitation import GoalForm
from freerein_imitation.model.policy import CameraFrames, ControlSpec, Policy, PolicyOutput, PolicySpec

_ENCODE_BATCH = 256


class PolicyNetwork(nn.Module):
    """Base of the networks.

    Attributes:
        spec: Inputs, outputs and sizes.
        in_distribution: Scores frames by their image statistics.
    """

    spec: InputSpec
    in_distribution: InDistribution


N = TypeVar("N", bound=PolicyNetwork)
P = TypeVar("P", bound=Policy)


class StepInputs(NamedTuple):
    """Arguments of `Policy.step` as tensors on the network's device."""

    frames: FrameTensors
    goals: Tensor
    previous: Tensor
    recurrent: Tensor
    robot_state: Tensor | None
    draws: Tensor | None


class StepOutputs(NamedTuple):
    """A network's output for B observations.

    Attributes:
        actions: float32 (B, K, A) in [-1, 1], or int64 (B, K, 1).
        reached: Probability that each observation is at its goal, float32 (B,).
        recurrent: Recurrent state after this step, float32 (B, R).
        confidence: Probability of what it says of the goal, for the in-distribution score, float32 (B,).
        settled: As of `PolicyOutput`, bool (B,) or None.
    """

    actions: Tensor
    reached: Tensor
    recurrent: Tensor
    confidence: Tensor
    settled: Tensor | None = None


class TorchPolicy(Policy, Generic[N]):
    """Base of policies that are torch networks.

    Args:
        network: Trained; its device is where the policy computes.
        control: Rate and limits, as on the card.
        goal_form: Form of its goals.
        fields: Further fields of the policy's spec.
    """

    def __init__(self, network: N, control: ControlSpec, *, goal_form: GoalForm, **fields: Any) -> None:
        inputs = network.spec
        self.spec = PolicySpec(
            **vars(control), cameras=inputs.cameras, action=inputs.action, goal_form=goal_form, **fields
        )
        self._network = network.eval()
        self._device = next(network.parameters()).device

    @torch.inference_mode()
    def step(
        self,
        frames: CameraFrames,
        goals: npt.NDArray[np.float32],
        previous: npt.NDArray[Any],
        recurrent: npt.NDArray[np.float32],
        robot_state: npt.NDArray[np.float32] | None = None,
        *,
        draws: npt.NDArray[np.float64] | None = None,
    ) -> PolicyOutput:
        """Returns the output for B observations; see `Policy.step`."""
        seen = self._tensors(frames)
        felt, drawn = (None if each is None else self._tensor(each) for each in (robot_state, draws))
        inputs = StepInputs(seen, self._tensor(goals), self._tensor(previous), self._tensor(recurrent), felt, drawn)
        output, familiarity = self.step_tensors(inputs)
        parts = (output.actions, output.reached, output.recurrent, familiarity)
        settled = None if output.settled is None else output.settled.cpu().numpy()
        actions, reached, recurrent, in_distribution = (each.cpu().numpy() for each in parts)
        return PolicyOutput(actions, reached, recurrent, in_distribution, settled)

    def step_tensors(self, inputs: StepInputs) -> tuple[StepOutputs, Tensor]:
        """Returns the network's output for B observations, and their in-distribution scores, float32 (B,)."""
        output, score = self._step(inputs), self._network.in_distribution
        return output, score(score.distance(image_statistics(inputs.frames)), output.confidence)

    @property
    def network(self) -> N:
        """The trained network."""
        return self._network

    def encode_images(self, images: FrameTensors) -> Tensor:
        """Returns goal embeddings, float32 (N, G), of goal images by camera, uint8 (N, H, W, C).

        Raises TypeError where goals are no images.
        """
        raise TypeError(f"goals of this policy are of the form {self.spec.goal_form}; expected images")

    def encode_goals(self, goals: Any) -> npt.NDArray[np.float32]:
        """Returns goal embeddings, float32 (N, G), of goal images by camera, uint8 (N, H, W, C), some at a time."""
        count = len(next(iter(goals.values())))
        batches = [slice(start, start + _ENCODE_BATCH) for start in range(0, count, _ENCODE_BATCH)]
        with torch.inference_mode():
            parts = [
                self.encode_images(self._tensors({name: each[batch] for name, each in goals.items()}))
                for batch in batches
            ]
            codes: npt.NDArray[np.float32] = torch.cat(parts).cpu().numpy()
        return codes

    @abstractmethod
    def _step(self, inputs: StepInputs) -> StepOutputs:
        """Returns the network's part of `step`."""

    def _tensor(self, array: npt.NDArray[Any]) -> Tensor:
        """Returns a copy on the network's device; arrays from the wire are read-only."""
        return torch.tensor(array, device=self._device)

    def _tensors(self, frames: CameraFrames) -> FrameTensors:
        return {camera: self._tensor(each) for camera, each in frames.items()}


def loader(policy: Callable[[N, ControlSpec], P], spec: type[C], network: Callable[[C], N]) -> Callable[[Path, str], P]:
    """Returns the function that loads a method's policies; see `freerein.learning.methods.Method.load`.

    Args:
        policy: Makes the policy of a trained network and of rate and limits.
        spec: Class of the network's spec.
        network: Makes the network of a spec.
    """

    def load(folder: Path, device: str) -> P:
        trained = model_files.load_model(folder, spec, network, device=device)
        return policy(trained, ControlSpec.from_card(model_files.read_card(folder)))

    return load


def confidence(reached: Tensor) -> Tensor:
    """Returns the probability of the likelier of reached and not reached, float32 (N,), of that of reached (N,)."""
    return torch.maximum(reached, 1 - reached)
