"""Policies of ppo runs, as they were trained: one goal each, given by its text."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freerein.errors import InvalidInput
from freerein.learning.actor_critic.networks import ActorCritic, ActorCriticSpec
from freerein.learning.image_statistics import statistics_sizes
from freerein.learning.in_distribution import InDistribution
from freerein.learning.inputs import InputSpec
from freerein_imitation.model.policy import ControlSpec
from freerein_imitation.model.torch_policy import PolicyNetwork, StepInputs, StepOutputs, TorchPolicy, loader

METHOD = "ppo"


@dataclass(frozen=True, kw_only=True)
class PPOPolicySpec(InputSpec):
    """Camera, actions and network of a policy.

    Attributes:
        network: The network that was trained.
        goal_text: The goal that it was trained for.

    Raises:
        InvalidInput: The network is not of one camera and of these actions.
    """

    network: ActorCriticSpec
    goal_text: str

    def __post_init__(self) -> None:
        super().__post_init__()
        network, shapes = self.network, [(each.height, each.width, each.channels) for each in self.cameras]
        actions = (network.action_size, network.action_choices)
        if network.vector_size or shapes != [network.observation_shape]:
            raise InvalidInput("The network of a ppo policy must see one camera's frames; this one does not.")
        if actions != (self.action.size, self.action.choices):
            raise InvalidInput("The network of a ppo policy must have the actions of its task; this one has others.")


class PPOPolicyNetwork(PolicyNetwork):
    """The trained network, and its in-distribution score."""

    spec: PPOPolicySpec

    def __init__(self, spec: PPOPolicySpec) -> None:
        super().__init__()
        self.spec = spec
        self.actor_critic = ActorCritic(spec.network)
        self.in_distribution = InDistribution(*statistics_sizes(spec.cameras))


class PPOPolicy(TorchPolicy[PPOPolicyNetwork]):
    """Takes the most likely action, and holds it for as many control steps as in training.

    Its recurrent state is that of the LSTM, the action that is held, and for how many control steps it has been.
    """

    def __init__(self, network: PPOPolicyNetwork, control: ControlSpec) -> None:
        spec = network.spec
        size = spec.network.recurrent_size + spec.action.size + 1
        super().__init__(
            network,
            control,
            goal_form="text",
            goal_texts=(spec.goal_text,),
            recurrent_size=size,
            predicts_reached=False,
        )

    def encode_goals(self, goals: tuple[str, ...]) -> npt.NDArray[np.float32]:
        """Returns nothing of goals, float32 (N, 0): there is only one."""
        return np.zeros((len(goals), 0), np.float32)

    def skip_steps(self, recurrent: npt.NDArray[np.float32], steps: npt.NDArray[np.int64]) -> npt.NDArray[np.float32]:
        """Returns recurrent states after control steps without an observation; see `Policy`.

        The action was held meanwhile. Where that was as long as in training, or longer, the next one is due.
        """
        held, repeat = recurrent[:, -1:], self._network.spec.network.action_repeat
        later = np.where(held == 0, held, np.minimum(held + steps[:, None], repeat) % repeat)
        return np.concatenate([recurrent[:, :-1], later.astype(np.float32)], axis=1)

    def _step(self, inputs: StepInputs) -> StepOutputs:
        spec = self._network.spec
        sizes = [spec.network.recurrent_size, spec.action.size, 1]
        memory, holding, held = torch.split(inputs.recurrent, sizes, dim=1)  # (B, R), (B, A), (B, 1)
        actions, after = self._choose(next(iter(inputs.frames.values())), inputs.previous, memory)
        is_due = held == 0  # (B, 1)
        actions, after = torch.where(is_due, actions, holding), torch.where(is_due, after, memory)
        state = torch.cat([after, actions, (held + 1) % spec.network.action_repeat], dim=1)
        chosen = actions[:, None].to(torch.int64 if spec.action.choices else torch.float32)
        never = torch.zeros(len(actions), device=self._device)
        return StepOutputs(chosen, never, state, torch.ones_like(never))

    def _choose(self, frames: Tensor, previous: Tensor, memory: Tensor) -> tuple[Tensor, Tensor]:
        """Returns the most likely actions, float32 (B, A), and the LSTM's state after them, float32 (B, R)."""
        network = self._network.actor_critic
        observed = network.observe(frames, previous.cpu()).to(self._device)
        no_starts = torch.zeros(1, len(frames), dtype=torch.bool, device=self._device)  # zeros are a start, too
        outputs = network(observed[None], no_starts, memory)
        return outputs.actions.mode()[0].float().clamp(*self.spec.action.bounds), outputs.recurrent_state


load = loader(PPOPolicy, PPOPolicySpec, PPOPolicyNetwork)
