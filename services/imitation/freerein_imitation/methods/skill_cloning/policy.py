"""The policy of skill cloning."""

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freerein_imitation.methods.shared.skill_policy import SkillPolicy
from freerein_imitation.methods.skill_cloning.memory import Memory
from freerein_imitation.methods.skill_cloning.network import SkillCloningNetwork
from freerein_imitation.model.policy import ControlSpec
from freerein_imitation.model.torch_policy import StepInputs, StepOutputs


class SkillCloningPolicy(SkillPolicy[SkillCloningNetwork]):
    """Executes skills by name. Its recurrent state is a `Memory`, which outlasts a skill: the robot moves on."""

    def __init__(self, network: SkillCloningNetwork, control: ControlSpec) -> None:
        spec = network.spec
        self._sizes = spec.memory_sizes
        super().__init__(
            network,
            control,
            goal_form="recipe",
            horizon=spec.chunk,
            skills=spec.skills,
            robot_state_size=spec.robot_state_size,
            recurrent_size=self._sizes.total,
            predicts_reached=spec.ends == "head",
        )

    @torch.inference_mode()
    def skip_steps(self, recurrent: npt.NDArray[np.float32], steps: npt.NDArray[np.int64]) -> npt.NDArray[np.float32]:
        """Returns recurrent states after control steps without an observation; see `Memory`."""
        memory = self._memory(self._tensor(recurrent)).skipped(self._tensor(steps), no_action=self._no_action())
        later: npt.NDArray[np.float32] = memory.flat().cpu().numpy()
        return later

    @torch.inference_mode()
    def reset_goal_state(self, recurrent: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Returns recurrent states with frames and actions alone; see `Memory`."""
        kept: npt.NDArray[np.float32] = self._memory(self._tensor(recurrent)).without_skill().flat().cpu().numpy()
        return kept

    def _step(self, inputs: StepInputs) -> StepOutputs:
        network, skill, felt = self._network, inputs.goals, inputs.robot_state
        memory = self._memory(inputs.recurrent).with_action(network.encode_actions(inputs.previous))
        features = network.encode(inputs.frames, felt)
        chunk, termination = network(features, skill, memory.features, memory.rates, memory.actions)
        ended = termination.sigmoid()
        later, averaged = memory.advanced(features, skill.argmax(dim=1), self._predicted(chunk), ended)
        reached = later.ended if self.spec.predicts_reached else torch.zeros_like(ended)
        return StepOutputs(self._actions(averaged), reached, later.flat(), network.confidence(ended, felt))

    def _memory(self, recurrent: Tensor) -> Memory:
        return Memory.parse(recurrent, self._sizes, no_action=self._no_action())

    def _no_action(self) -> Tensor:
        return self._network.encode_actions(self._tensor(self.spec.action.no_action()))

    def _predicted(self, chunk: Tensor) -> Tensor:
        """Returns the quantities averaged over predictions: actions, or probabilities of choices; float32 (B, K, O)."""
        network = self._network
        return chunk.softmax(dim=2) if self.spec.action.choices else chunk * network.action_std + network.action_mean

    def _actions(self, averaged: Tensor) -> Tensor:
        if self.spec.action.choices:
            return averaged.argmax(dim=2, keepdim=True)
        return averaged.clamp(-1, 1)
