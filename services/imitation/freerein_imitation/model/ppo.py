"""Policies of ppo runs, as they were trained: one goal each, given by its text."""

import math
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
from freerein_imitation.model.policy import RESTORE, ControlSpec
from freerein_imitation.model.torch_policy import PolicyNetwork, StepInputs, StepOutputs, TorchPolicy, loader

METHOD = "ppo"


@dataclass(frozen=True, kw_only=True)
class PPOPolicySpec(InputSpec):
    """Cameras, actions and network of a policy.

    Attributes:
        network: The network that was trained.
        goal_text: The goal that it was trained for.

    Raises:
        InvalidInput: The network is not of these cameras and actions.
    """

    network: ActorCriticSpec
    goal_text: str

    def __post_init__(self) -> None:
        super().__post_init__()
        network, shapes = self.network, [(each.height, each.width, each.channels) for each in self.cameras]
        actions = (network.action_size, network.action_choices)
        if network.vector_size or shapes != [(network.height, network.width, network.channels)] * network.cameras:
            raise InvalidInput(
                f"The network of a ppo policy must see the frames of its cameras, {shapes}; this one sees "
                f"{network.cameras} of {(network.height, network.width, network.channels)}.",
                hint=RESTORE,
            )
        if actions != (self.action.size, self.action.choices):
            raise InvalidInput(
                f"The network of a ppo policy must have {self.action.size} numbers and {self.action.choices} choices "
                f"per action, as its task; this one has {actions[0]} and {actions[1]}.",
                hint=RESTORE,
            )


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

    Its recurrent state is that of the LSTM, the action that is held, and for how many control steps it has been. With a
    stack of frames, whether there are earlier frames follows, and their pixels.
    """

    def __init__(self, network: PPOPolicyNetwork, control: ControlSpec) -> None:
        spec = network.spec
        pixels = math.prod(spec.network.earlier_shape)
        self._parts = [spec.network.recurrent_size, spec.action.size, 1, int(pixels > 0), pixels]
        super().__init__(
            network,
            control,
            goal_form="text",
            goal_texts=(spec.goal_text,),
            recurrent_size=sum(self._parts),
            recurrent_pixels=pixels,
            predicts_reached=False,
        )

    def encode_goals(self, goals: tuple[str, ...]) -> npt.NDArray[np.float32]:
        """Returns nothing of goals, float32 (N, 0): there is only one."""
        return np.zeros((len(goals), 0), np.float32)

    def skip_steps(self, recurrent: npt.NDArray[np.float32], steps: npt.NDArray[np.int64]) -> npt.NDArray[np.float32]:
        """Returns recurrent states after control steps without an observation; see `Policy`.

        The action was held meanwhile. Where that was as long as in training, or longer, the next one is due.
        """
        later, at, repeat = recurrent.copy(), sum(self._parts[:2]), self._network.spec.network.action_repeat
        held = recurrent[:, at]
        later[:, at] = np.where(held == 0, held, np.minimum(held + steps, repeat) % repeat)
        return later

    def _step(self, inputs: StepInputs) -> StepOutputs:
        spec = self._network.spec
        memory, holding, held, begun, pixels = torch.split(inputs.recurrent, self._parts, dim=1)  # (B, ...) each
        observed = self._observe(inputs, begun, pixels)
        actions, after = self._choose(observed, memory)
        seen = self._network.actor_critic.earlier_frames(observed).flatten(start_dim=1)
        is_due = held == 0  # (B, 1)
        actions, after, seen = (
            torch.where(is_due, new, old) for new, old in ((actions, holding), (after, memory), (seen, pixels))
        )
        state = torch.cat(
            [after, actions, (held + 1) % spec.network.action_repeat, torch.ones_like(begun), seen], dim=1
        )
        chosen = actions[:, None].to(torch.int64 if spec.action.choices else torch.float32)
        never = torch.zeros_like(held[:, 0])
        return StepOutputs(chosen, never, state, torch.ones_like(never))

    def _observe(self, inputs: StepInputs, begun: Tensor, pixels: Tensor) -> Tensor:
        """Returns observations as the network takes them, (B, ...), of `begun` robots with earlier `pixels`."""
        network = self._network.actor_critic
        frames = torch.cat([inputs.frames[camera.name] for camera in self.spec.cameras], dim=-1)
        earlier = pixels.to(torch.uint8).view(frames.shape[0], *network.spec.earlier_shape)
        return network.observe(frames, inputs.previous.cpu(), earlier, (begun == 0).any(dim=1)).to(self._device)

    def _choose(self, observed: Tensor, memory: Tensor) -> tuple[Tensor, Tensor]:
        """Returns the most likely actions, float32 (B, A), and the LSTM's state after them, float32 (B, R)."""
        network = self._network.actor_critic
        no_starts = torch.zeros(1, observed.shape[0], dtype=torch.bool, device=self._device)  # zeros are a start, too
        outputs = network(observed[None], no_starts, memory)
        return outputs.actions.mode()[0].float().clamp(*self.spec.action.bounds), outputs.recurrent_state


load = loader(PPOPolicy, PPOPolicySpec, PPOPolicyNetwork)
