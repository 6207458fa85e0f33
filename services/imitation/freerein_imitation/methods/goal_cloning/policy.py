"""The policy of goal cloning."""

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freerein.learning.encoders import FrameTensors
from freerein_imitation.methods.goal_cloning.network import GoalCloningNetwork
from freerein_imitation.methods.shared import action_bins
from freerein_imitation.model.policy import ControlSpec
from freerein_imitation.model.torch_policy import StepInputs, StepOutputs, TorchPolicy, confidence


class GoalCloningPolicy(TorchPolicy[GoalCloningNetwork]):
    """Follows goal images. Its recurrent state is the features of the last observation; zeros for none.

    Training saw the observation one control step earlier, or none. One from longer ago counts as none.
    """

    def __init__(self, network: GoalCloningNetwork, control: ControlSpec) -> None:
        super().__init__(network, control, goal_form="images", recurrent_size=network.encoder.size)

    def encode_images(self, images: FrameTensors) -> Tensor:
        """Returns features of goal images, float32 (N, D), by camera, uint8 (N, H, W, C)."""
        features: Tensor = self._network.encoder(images)
        return features

    def skip_steps(self, recurrent: npt.NDArray[np.float32], steps: npt.NDArray[np.int64]) -> npt.NDArray[np.float32]:
        """Returns recurrent states after control steps without an observation; see `Policy`."""
        later: npt.NDArray[np.float32] = recurrent * (steps == 0)[:, None]
        return later

    def _step(self, inputs: StepInputs) -> StepOutputs:
        features, last = self._network.encoder(inputs.frames), inputs.recurrent
        before = torch.where((last != 0).any(dim=1, keepdim=True), last, features)
        logits = self._network(features, inputs.goals, before, inputs.previous)
        reached = self._network.recognizer(features, inputs.goals)
        actions = action_bins.decode(logits, choices=self.spec.action.choices)[:, None]
        return StepOutputs(actions, reached, features, confidence(reached))
