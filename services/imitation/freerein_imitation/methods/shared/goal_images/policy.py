"""The policy around a network that follows goal images."""

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freerein.learning.encoders import FrameTensors
from freerein_imitation.methods.shared import action_bins
from freerein_imitation.methods.shared.goal_images.network import GoalImagesNetwork, proximity_logit
from freerein_imitation.model.policy import CameraFrames, ControlSpec
from freerein_imitation.model.torch_policy import StepInputs, StepOutputs, TorchPolicy, confidence


class GoalImagesPolicy(TorchPolicy[GoalImagesNetwork]):
    """Follows goal images.

    A recurrent network moves on once per observation. Its training saw one of every control step, so it acts best where
    it observes each; of steps that it did not see it is told no more than the last action.
    """

    def __init__(self, network: GoalImagesNetwork, control: ControlSpec) -> None:
        size = network.policy.recurrent_size
        super().__init__(network, control, goal_form="images", recurrent_size=size)

    def encode_goals(self, goals: CameraFrames) -> npt.NDArray[np.float32]:
        """Returns goal embeddings, float32 (N, G), of goal images by camera, uint8 (N, H, W, C)."""
        return self._encode_images(self._encode, goals)

    def _step(self, inputs: StepInputs) -> StepOutputs:
        policy, codes, goal = self._network.policy, self._encode(inputs.frames), inputs.goals
        size = policy.encoder.size
        logits, state = policy.step(codes[:, :size], goal[:, :size], inputs.previous, inputs.recurrent)
        reached = proximity_logit(codes[:, size:], goal[:, size:]).sigmoid()
        actions = action_bins.decode(logits, choices=self.spec.action.choices)
        return StepOutputs(actions, reached, state, confidence(reached))

    def _encode(self, frames: FrameTensors) -> Tensor:
        """Returns the policy's features beside the recognizer's embedding, float32 (N, G)."""
        return torch.cat([self._network.policy.encoder(frames), self._network.recognizer(frames)], dim=1)
