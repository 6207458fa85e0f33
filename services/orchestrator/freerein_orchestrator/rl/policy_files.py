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
    """Acts with a network in N environments.

    Args:
        network: Not changed.
        generator: Samples the actions, on the CPU; None for the mode of the distribution.
    """

    def __init__(self, network: ActorCritic, *, generator: torch.Generator | None = None) -> None:
        self._network = network
        self._generator = generator
        self._recurrent_state: torch.Tensor | None = None

    @torch.no_grad()
    def act(self, frames: Observations, episode_starts: npt.NDArray[np.bool_]) -> Actions:
        """Returns an action per environment.

        Args:
            frames: uint8 (N, H, W, C).
            episode_starts: bool (N,); the recurrent state is reset there.

        Raises:
            InvalidInput: The frames are not what the network takes.
        """
        spec, device = self._network.spec, next(self._network.parameters()).device
        observations = observation_tensor(frames, spec, len(episode_starts))[None].to(device)
        state = self._recurrent_state
        state = torch.zeros(len(episode_starts), spec.recurrent_size, device=device) if state is None else state
        outputs = self._network(observations, torch.from_numpy(episode_starts)[None].to(device), state)
        self._recurrent_state = outputs.recurrent_state
        actions = outputs.actions.mode() if self._generator is None else outputs.actions.sample(self._generator)
        return env_actions(actions[0])
