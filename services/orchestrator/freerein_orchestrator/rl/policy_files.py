"""A trained policy on disk, and acting with it.

<folder>/policy.safetensors   weights
         policy.json          card: `spec`, task, reward, supervision, figures
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freerein.errors import InvalidInput
from freerein.learning import model_files, weights
from freerein.learning.checkpoints import JSON
from freerein_orchestrator.rl.networks import ActorCritic, ActorCriticSpec
from freerein_orchestrator.rl.vec_env import Actions, Observations, env_actions, observation_tensor

KIND = "ppo"
NAMES = model_files.ModelFileNames("policy.safetensors", "policy.json")


@dataclass(frozen=True, eq=False)
class StoredPolicy:
    """A trained policy and its card.

    Attributes:
        network: In evaluation mode.
        card: Task, reward, supervision, figures.
    """

    network: ActorCritic
    card: Mapping[str, Any]


def save_policy(network: ActorCritic, folder: Path, *, card: Mapping[str, JSON]) -> None:
    """Writes a policy as a folder; the card gets the sha256 of the weights.

    Args:
        network: Trained.
        folder: Made when missing; its files are overwritten.
        card: Besides kind and spec.
    """
    model_files.save_model(network, folder, card={"kind": KIND, **card, "sha256": weights.sha256(network)}, names=NAMES)


def load_policy(folder: Path, *, device: str) -> StoredPolicy:
    """Returns the policy in a folder.

    Args:
        folder: Written by `save_policy`; read as untrusted.
        device: `auto`, `cpu` or `cuda:N`.

    Raises:
        InvalidInput: A file is missing or malformed, or the card is of other weights.
    """
    network = model_files.load_model(folder, ActorCriticSpec, ActorCritic, device=device, names=NAMES)
    card = model_files.read_card(folder, names=NAMES)
    if card.get("kind") != KIND or card.get("sha256") != weights.sha256(network):
        raise InvalidInput(
            "A policy's card must be of kind ppo and hold the sha256 of its weights; it does not.",
            hint="Run ppo again, or restore its folder from a copy.",
        )
    return StoredPolicy(network, card)


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
    def act(self, frames: Observations, episode_starts: npt.NDArray[np.bool_]) -> Actions:
        """Returns an action per environment.

        Args:
            frames: uint8 (N, H, W, C).
            episode_starts: bool (N,); the recurrent state is reset there.

        Raises:
            InvalidInput: The frames are not what the network takes.
        """
        spec, starts = self._network.spec, torch.from_numpy(episode_starts)
        observations = observation_tensor(frames, spec, len(starts))
        memory = _Memory.init(spec, len(starts)) if self._memory is None else self._memory.reset(starts)
        due = memory.held == 0
        if due.any():
            actions, recurrent_state = self._choose(observations[due], starts[due], memory, due)
            memory.actions[due], memory.recurrent_state[due] = actions, recurrent_state
        held = (memory.held + 1) % spec.action_repeat
        self._memory = _Memory(memory.actions, memory.recurrent_state, held)
        return env_actions(memory.actions)

    def _choose(self, observations: Tensor, starts: Tensor, memory: "_Memory", due: Tensor) -> tuple[Tensor, Tensor]:
        """Returns new actions and recurrent states of the environments that are `due`."""
        device = next(self._network.parameters()).device
        seen = self._network.observe(observations, memory.actions[due].clamp(-1, 1))
        state = memory.recurrent_state[due].to(device)
        outputs = self._network(seen[None].to(device), starts[None].to(device), state)
        actions = outputs.actions.mode() if self._generator is None else outputs.actions.sample(self._generator)
        return actions[0].cpu(), outputs.recurrent_state.cpu()


@dataclass(frozen=True, eq=False)
class _Memory:
    """What a policy remembers of each environment.

    Attributes:
        actions: The present one, float32 (N, A) or int64 (N, 1); 0 before the first.
        recurrent_state: float32 (N, recurrent_size).
        held: Timesteps that it has been held for; 0 where a new one is due. int64 (N,).
    """

    actions: Tensor
    recurrent_state: Tensor
    held: Tensor

    @classmethod
    def init(cls, spec: ActorCriticSpec, num_envs: int) -> "_Memory":
        """Returns the memory before the first action."""
        dtype = torch.int64 if spec.action_choices else torch.float32
        return cls(
            torch.zeros(num_envs, spec.action_size, dtype=dtype),
            torch.zeros(num_envs, spec.recurrent_size),
            torch.zeros(num_envs, dtype=torch.int64),
        )

    def reset(self, starts: Tensor) -> "_Memory":
        """Returns the memory without that of the episodes that ended; recurrent states are reset by the network."""
        return _Memory(self.actions * ~starts[:, None], self.recurrent_state, self.held * ~starts)
