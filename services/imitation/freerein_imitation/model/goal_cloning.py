"""Goal-conditioned behavioural cloning for goal images, with a goal recognizer by odometry.

Observation, goal and previous observation meet as features of one spatial encoder, beside their differences, and there
is no recurrence beyond the previous observation (Ghosh et al., "Learning to reach goals via iterated supervised
learning", 2021, in a single iteration).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from freerein.config import bounded, one_of
from freerein.learning.encoders import ENCODERS, CameraEncoders, FrameTensors
from freerein.learning.image_statistics import image_statistics, statistics_size
from freerein.learning.in_distribution import InDistribution
from freerein.learning.inputs import InputSpec
from freerein_imitation.model import action_bins
from freerein_imitation.model.odometry_recognizer import OdometryRecognizer
from freerein_imitation.model.perceptron import perceptron
from freerein_imitation.model.policy import CameraFrames, ControlSpec, PolicyOutput, TorchPolicy, confidence

_DEPTH = 3
_GOAL_CONTRAST, _MOTION_CONTRAST = 2.0, 4.0  # of differences of features


@dataclass(frozen=True, kw_only=True)
class GoalCloningSpec(InputSpec):
    """Inputs, outputs and sizes of the network.

    Attributes:
        encoder: Image encoder.
        features: Image features per camera.
        hidden_size: Units of the hidden layers.
    """

    encoder: str = one_of(ENCODERS, "moments")
    features: int = bounded(80, least=8, most=1024)
    hidden_size: int = bounded(256, least=8, most=1024)

    @property
    def categories(self) -> int:
        """Categories of each number of an action."""
        return self.action.choices or action_bins.BINS


class GoalCloningNetwork(nn.Module):
    """Encoder, policy and goal recognizer."""

    def __init__(self, spec: GoalCloningSpec) -> None:
        super().__init__()
        self.spec = spec
        self.encoder = CameraEncoders(ENCODERS[spec.encoder], spec.cameras, features=spec.features)
        inputs, outputs = 3 * self.encoder.size + spec.encoded_action_size, spec.action.size * spec.categories
        self.policy = perceptron(inputs, outputs, hidden_size=spec.hidden_size, depth=_DEPTH)
        self.recognizer = OdometryRecognizer(
            features=self.encoder.size, hidden_size=spec.hidden_size, action=spec.action
        )
        self.in_distribution = InDistribution(statistics_size(spec.cameras))

    def forward(self, features: Tensor, goal: Tensor, before: Tensor, previous: Tensor) -> Tensor:
        """Returns action logits, float32 (B, A, categories).

        Args:
            features: Of observations, float32 (B, D).
            goal: Features of goals, float32 (B, D).
            before: Features of the observations one step earlier, float32 (B, D).
            previous: Actions executed last, float32 (B, A), zeros for none, or int64 (B, 1), -1 for none.
        """
        if self.spec.action.choices:
            previous = action_bins.encode(previous, choices=self.spec.action.choices).flatten(1)  # (B, choices)
        differences = _GOAL_CONTRAST * (goal - features), _MOTION_CONTRAST * (features - before)
        logits: Tensor = self.policy(torch.cat([features, *differences, previous], dim=1))
        return logits.view(-1, self.spec.action.size, self.spec.categories)


class GoalCloningPolicy(TorchPolicy[GoalCloningNetwork]):
    """Follows goal images. Its recurrent state is the features of the last observation; zeros for none.

    Training saw the observation one control step earlier, or none. One from longer ago counts as none.

    Args:
        network: Trained.
        control: Rate and limits.
    """

    def __init__(self, network: GoalCloningNetwork, control: ControlSpec) -> None:
        super().__init__(network, network.spec, control, goal_form="images", recurrent_size=network.encoder.size)

    @torch.inference_mode()
    def encode_goals(self, goals: CameraFrames) -> npt.NDArray[np.float32]:
        """Returns features of goal images, float32 (N, D), by camera, uint8 (N, H, W, C)."""
        return self._encode_images(self._encode, goals)

    def skip_steps(self, recurrent: npt.NDArray[np.float32], steps: npt.NDArray[np.int64]) -> npt.NDArray[np.float32]:
        """Returns recurrent states after control steps without an observation; see `TimedPolicy`."""
        later: npt.NDArray[np.float32] = recurrent * (steps == 0)[:, None]
        return later

    @torch.inference_mode()
    def step(
        self,
        frames: CameraFrames,
        goals: npt.NDArray[np.float32],
        previous: npt.NDArray[Any],
        recurrent: npt.NDArray[np.float32],
    ) -> PolicyOutput:
        """Returns the output for B observations; arguments as in `Policy.step`."""
        seen, goal, last = self._tensors(frames), self._tensor(goals), self._tensor(recurrent)
        features, score = self._encode(seen), self._network.in_distribution
        before = torch.where((last != 0).any(dim=1, keepdim=True), last, features)
        logits = self._network(features, goal, before, self._tensor(previous))
        reached = self._network.recognizer(features, goal)
        return PolicyOutput(
            actions=action_bins.decode(logits, choices=self.spec.action.choices)[:, None].cpu().numpy(),
            reached=reached.cpu().numpy(),
            recurrent=features.cpu().numpy(),
            in_distribution=score(score.distance(image_statistics(seen)), confidence(reached)).cpu().numpy(),
        )

    def _encode(self, frames: FrameTensors) -> Tensor:
        features: Tensor = self._network.encoder(frames)
        return features
