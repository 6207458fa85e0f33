"""The policy around a network that follows goal images."""

from torch import Tensor

from freerein.learning.encoders import FrameTensors
from freerein_imitation.methods.shared.goal_images.network import GoalImagesNetwork
from freerein_imitation.model.policy import ControlSpec
from freerein_imitation.model.torch_policy import StepInputs, StepOutputs, TorchPolicy, confidence


class GoalImagesPolicy(TorchPolicy[GoalImagesNetwork]):
    """Follows goal images.

    A recurrent network moves on once per observation. Its training saw one of every control step, so it acts best where
    it observes each; of steps that it did not see, its only input is the last action.
    """

    def __init__(self, network: GoalImagesNetwork, control: ControlSpec) -> None:
        policy, is_sampled = network.policy, network.spec.temperature > 0
        draws = policy.action_head.draws if is_sampled else 0
        super().__init__(network, control, goal_form="images", recurrent_size=policy.recurrent_size, draws=draws)

    def encode_images(self, images: FrameTensors) -> Tensor:
        """Returns goal embeddings, float32 (N, G), of goal images by camera, uint8 (N, H, W, C)."""
        embeddings: Tensor = self._network(images)
        return embeddings

    def _step(self, inputs: StepInputs) -> StepOutputs:
        policy, codes, goals = self._network.policy, self._network(inputs.frames), inputs.goals
        size = policy.code_size
        context, state = policy.step(codes[:, :size], goals[:, :size], inputs.previous, inputs.recurrent)
        actions = policy.action_head.act(context, inputs.draws, temperature=self._network.spec.temperature)
        reached = self._network.reached(context, codes, goals)
        return StepOutputs(actions[:, None], reached, state, confidence(reached))
