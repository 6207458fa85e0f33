"""A policy as a run leaves it behind: its weights and its card, and what acts by it.

<folder>/policy.safetensors   weights
         policy.json          `spec`: what the network is; what it was taught, on whose rewards, with which figures
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
import torch

from freerein.errors import InvalidInput
from freerein.learning import model_files, weights
from freerein.learning.checkpoints import JSON
from freerein_orchestrator.networks import ActorCritic, ActorCriticSpec
from freerein_orchestrator.rollout import Actions, Observations, checked_observations, executable

KIND = "ppo"
NAMES = model_files.ModelFileNames("policy.safetensors", "policy.json")


@dataclass(frozen=True, eq=False)
class Policy:
    """A trained policy.

    Attributes:
        network: In evaluation mode.
        card: What is told about it.
    """

    network: ActorCritic
    card: Mapping[str, Any]


class Actor(Protocol):
    """What acts in N environments, timestep by timestep."""

    def act(self, frames: Observations, starts: npt.NDArray[np.bool_]) -> Actions:
        """Returns an action for each environment.

        Args:
            frames: Of N environments, uint8 (N, H, W, C).
            starts: Where an episode begins, bool (N,): nothing is remembered there from before.
        """


def save(network: ActorCritic, folder: Path, *, card: Mapping[str, JSON]) -> None:
    """Writes a policy as a folder that `load` reads, with the sha256 of its weights in the card.

    Args:
        network: Trained.
        folder: Made when missing; its files are written over.
        card: What to tell about the policy beside kind and spec.
    """
    told = {"kind": KIND, **card, "sha256": weights.sha256(network)}
    model_files.save_model(network, folder, card=told, names=NAMES)


def load(folder: Path, *, device: str) -> Policy:
    """Returns the policy in a folder.

    Args:
        folder: Written by `save`; read as untrusted.
        device: `auto`, `cpu` or `cuda:N`.

    Raises:
        InvalidInput: A file is missing, or is not what `save` writes, or the card is of other weights.
    """
    network = model_files.load_model(folder, ActorCriticSpec, ActorCritic, device=device, names=NAMES)
    card = model_files.read_card(folder, names=NAMES)
    if card.get("kind") != KIND or card.get("sha256") != weights.sha256(network):
        raise InvalidInput(
            "A policy's card must be of kind ppo and name the sha256 of its weights; it does not.",
            hint="Run ppo again, or restore its folder from a copy.",
        )
    return Policy(network, card)


class PolicyActor:
    """Acts by a policy.

    Args:
        network: The policy; it is not changed.
        generator: Draws the actions, on the CPU; None for the likeliest action each time.
    """

    def __init__(self, network: ActorCritic, *, generator: torch.Generator | None = None) -> None:
        self._network = network
        self._generator = generator
        self._memory: torch.Tensor | None = None

    @torch.no_grad()
    def act(self, frames: Observations, starts: npt.NDArray[np.bool_]) -> Actions:
        """Returns an action for each environment, as `Actor.act`.

        Raises:
            InvalidInput: The frames are not what the network sees.
        """
        spec, device = self._network.spec, next(self._network.parameters()).device
        seen = checked_observations(frames, spec, len(starts))[None].to(device)
        memory = torch.zeros(len(starts), spec.memory_size) if self._memory is None else self._memory
        outputs = self._network(seen, torch.from_numpy(starts)[None].to(device), memory.to(device))
        self._memory = outputs.memory
        drawn = outputs.actions.mode() if self._generator is None else outputs.actions.sample(self._generator)
        return executable(drawn[0])
