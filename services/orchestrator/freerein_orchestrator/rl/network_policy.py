"""Acting with the policy of a ppo run; `freerein.learning.actor_critic` has its files and its network."""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freerein.learning.actor_critic.networks import ActorCritic, ActorCriticSpec
from freerein_orchestrator.rl.vec_env import Actions, Observations, env_actions, executed_actions, observation_tensor


class NetworkPolicy:
    """Acts with a network in N environments, holding each action for as many timesteps as the network's spec says.

    Args:
        network: Not changed.
        generator: Samples the actions, on the CPU; None for the mode of the distribution.
    """

    def __init__(self, network: ActorCritic, *, generator: torch.Generator | None = None) -> None:
        self._network = network
        self._generator = generator
        self._memory: _Memory | None = None

    @torch.no_grad()
    def act(
        self, frames: Observations, episode_starts: npt.NDArray[np.bool_], *, executed: Actions | None = None
    ) -> Actions:
        """Returns an action per environment.

        Args:
            frames: uint8 (N, H, W, C), those of several cameras side by side on the channels.
            episode_starts: bool (N,); the recurrent state is reset there.
            executed: Actions (N, A) that another policy took before these frames, not read where an episode starts;
                None where this policy's own were executed.

        Raises:
            InvalidInput: The frames are not what the network takes.
        """
        spec, starts = self._network.spec, torch.from_numpy(episode_starts)
        observations = observation_tensor(frames, spec, len(starts))
        memory = _Memory.init(spec, len(starts)) if self._memory is None else self._memory.reset(starts)
        last = executed_actions(memory.actions) if executed is None else torch.from_numpy(executed) * ~starts[:, None]
        due = memory.held == 0
        if due.any():
            self._choose(observations[due], last[due], starts[due], memory, due)
        self._memory = replace(memory, held=(memory.held + 1) % spec.action_repeat)
        return env_actions(memory.actions)

    def _choose(self, frames: Tensor, last: Tensor, starts: Tensor, memory: "_Memory", due: Tensor) -> None:
        """Sets new actions, recurrent states and earlier frames of the environments that are `due`."""
        device = next(self._network.parameters()).device
        observations = self._network.observe(frames, last, memory.earlier_frames[due], starts)
        state = memory.recurrent_state[due].to(device)
        outputs = self._network(observations[None].to(device), starts[None].to(device), state)
        actions = outputs.actions.mode() if self._generator is None else outputs.actions.sample(self._generator)
        memory.actions[due], memory.recurrent_state[due] = actions[0].cpu(), outputs.recurrent_state.cpu()
        memory.earlier_frames[due] = self._network.earlier_frames(observations)


@dataclass(frozen=True, eq=False)
class _Memory:
    """A policy's memory of each environment.

    Attributes:
        actions: The present one, float32 (N, A) or int64 (N, 1); 0 before the first.
        recurrent_state: float32 (N, recurrent_size).
        earlier_frames: Frames that the next observation stacks, uint8 (N, *earlier_shape).
        held: Timesteps that it has been held for; 0 where a new one is due. int64 (N,).
    """

    actions: Tensor
    recurrent_state: Tensor
    earlier_frames: Tensor
    held: Tensor

    @classmethod
    def init(cls, spec: ActorCriticSpec, num_envs: int) -> "_Memory":
        """Returns the memory before the first action."""
        dtype = torch.int64 if spec.action_choices else torch.float32
        return cls(
            torch.zeros(num_envs, spec.action_size, dtype=dtype),
            torch.zeros(num_envs, spec.recurrent_size),
            torch.zeros(num_envs, *spec.earlier_shape, dtype=torch.uint8),
            torch.zeros(num_envs, dtype=torch.int64),
        )

    def reset(self, starts: Tensor) -> "_Memory":
        """Returns the memory without that of the episodes that ended; the network resets recurrent state and frames."""
        return replace(self, actions=self.actions * ~starts[:, None], held=self.held * ~starts)
