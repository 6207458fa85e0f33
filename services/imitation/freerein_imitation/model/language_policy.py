"""A trained language policy as the service knows it: numpy in, numpy out. Its text tower comes with it."""

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freerein.atomic_files import write_atomic
from freerein.errors import InvalidInput
from freerein.learning import model_files
from freerein.learning.checkpoints import JSON
from freerein_imitation.model.handshake import Handshake
from freerein_imitation.model.language import LanguageNetwork, LanguageSpec
from freerein_imitation.model.step import Step
from freerein_imitation.model.text_tower import TextTower

NEVER_REACHED = 1.0
"""The threshold of a policy that cannot tell whether a goal is reached, and whose probability is always 0."""

_TOWER_FILE, _KEY = "text_tower.safetensors", "text_tower"


class LanguagePolicy:
    """Does what a sentence says. The network's device is where it computes; arrays are on the CPU.

    It has no termination head: nobody told it when a goal is reached, and it never says so. It remembers nothing.

    Args:
        network: Trained.
        tower: With which.
        handshake: What it is to a robot.

    Attributes:
        kind: `language`.
        camera: Which camera's frames it was trained on.
        height: Of the frames, in pixels.
        width: In pixels.
        channels: 1 or 3.
        action: What an action is.
        action_size: A, numbers per action.
        action_choices: How many different actions there are when they are discrete, else 0.
        horizon: Actions per answer, 1.
        control_dt_s: Time between two actions, in seconds.
        skills: None.
        memory_size: 0.
        reached_threshold: `NEVER_REACHED`.
        max_steps_per_goal: Control steps after which a goal is given up, unless a request says otherwise.
    """

    kind: Literal["language"] = "language"
    horizon = 1
    skills: tuple[str, ...] = ()
    memory_size = 0
    reached_threshold = NEVER_REACHED

    def __init__(self, network: LanguageNetwork, tower: TextTower, handshake: Handshake) -> None:
        spec = network.spec
        if tower.width != spec.text_width:
            raise InvalidInput(
                f"A policy's text tower must make codes of {spec.text_width} numbers; its own makes {tower.width}.",
                hint="Fit the model again, or restore its folder from a copy.",
            )
        self.camera = spec.camera
        self.height, self.width, self.channels = spec.height, spec.width, spec.channels
        self.action = handshake.action
        self.action_size, self.action_choices = spec.action_size, spec.action_choices
        self.control_dt_s = handshake.control_dt_s
        self.max_steps_per_goal = handshake.max_steps_per_goal
        self._network = network.eval()
        self._tower = tower
        self._device = next(network.parameters()).device

    def encode_goals(self, goals: Sequence[str]) -> npt.NDArray[np.float32]:
        """Returns the text tower's codes of sentences, float32 (N, text_width)."""
        return self._tower(goals)

    @torch.inference_mode()
    def step(
        self,
        frames: npt.NDArray[np.uint8],
        goals: npt.NDArray[np.float32],
        previous: npt.NDArray[Any],
        memory: npt.NDArray[np.float32],
    ) -> Step:
        """Does what sentences say.

        Args:
            frames: uint8 (B, H, W, C).
            goals: float32 (B, text_width), from `encode_goals`.
            previous: The actions executed last; it does not look at them.
            memory: float32 (B, 0).
        """
        actions = self._network(self._load(frames), self._load(goals))
        chosen = actions.argmax(dim=2) if self.action_choices else actions.clamp(-1, 1)  # (B, A)
        return Step(actions=chosen[:, None].cpu().numpy(), reached=np.zeros(len(previous), np.float32), memory=memory)

    def _load(self, array: npt.NDArray[Any]) -> Tensor:
        """Returns a copy on the network's device: arrays that came over a wire cannot be written to."""
        return torch.tensor(array, device=self._device)


def save(network: LanguageNetwork, tower: bytes, folder: Path, *, name: str, card: dict[str, JSON]) -> None:
    """Writes a policy as a folder that `load` reads.

    Args:
        network: Trained.
        tower: The text tower's file.
        folder: Made when missing; its files are written over.
        name: The text tower's.
        card: What to tell about the model beside its `spec` and its text tower.
    """
    folder.mkdir(parents=True, exist_ok=True)
    write_atomic(folder / _TOWER_FILE, tower)
    model_files.save_model(
        network, folder, card={**card, _KEY: {"name": name, "sha256": hashlib.sha256(tower).hexdigest()}}
    )


def load(folder: Path, device: str) -> LanguagePolicy:
    """Returns the language policy in a folder.

    Args:
        folder: Written by `save`; read as untrusted.
        device: `auto`, `cpu` or `cuda:N`.

    Raises:
        InvalidInput: A file is missing, or is not what a fit writes; the text tower is not the one of the card.
    """
    card = model_files.read_card(folder)
    network = model_files.load_model(folder, LanguageSpec, LanguageNetwork, device=device)
    return LanguagePolicy(network, _load_tower(folder, card), Handshake.from_card(card))


def _load_tower(folder: Path, card: dict[str, Any]) -> TextTower:
    try:
        data, expected = (folder / _TOWER_FILE).read_bytes(), card[_KEY]["sha256"]
    except (OSError, KeyError, TypeError):
        data, expected = b"", None
    if hashlib.sha256(data).hexdigest() != expected:
        raise InvalidInput(
            "A language policy's folder must hold the text tower whose sha256 its card names; it does not.",
            hint="Fit the model again, or restore its folder from a copy.",
        )
    return TextTower(data)
