"""Trained skills as the service knows them: numpy in, numpy out."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import torch

from freerein.errors import InvalidInput
from freerein.learning import model_files
from freerein_imitation.model.handshake import Handshake
from freerein_imitation.model.skills import SkillsNetwork, SkillsSpec
from freerein_imitation.model.step import Step


class SkillsPolicy:
    """Executes skills by name. The network's device is where it computes; arrays are on the CPU.

    Args:
        network: Trained.
        handshake: What it is to a robot.

    Attributes:
        kind: `skills`.
        camera: Which camera's frames it was trained on.
        height: Of the frames, in pixels.
        width: In pixels.
        channels: 1 or 3.
        action: What an action is.
        action_size: A, numbers per action.
        action_choices: How many different actions there are when they are discrete, else 0.
        horizon: Actions per answer, 1.
        control_dt_s: Time between two actions, in seconds.
        skills: What it can do.
        memory_size: M, floats of recurrent memory: hidden state and cell.
        reached_threshold: A skill has ended when the probability that it has is at least this.
        max_steps_per_goal: Control steps after which a skill is given up, unless a request says otherwise.
    """

    kind: Literal["skills"] = "skills"
    horizon = 1

    def __init__(self, network: SkillsNetwork, handshake: Handshake) -> None:
        spec = network.spec
        self.camera = spec.camera
        self.height, self.width, self.channels = spec.height, spec.width, spec.channels
        self.action = handshake.action
        self.action_size, self.action_choices = spec.action_size, spec.action_choices
        self.control_dt_s = handshake.control_dt_s
        self.skills = spec.skills
        self.memory_size = 2 * spec.memory
        self.reached_threshold = handshake.reached_threshold
        self.max_steps_per_goal = handshake.max_steps_per_goal
        self._network = network.eval()
        self._device = next(network.parameters()).device

    def encode_goals(self, goals: Sequence[str]) -> npt.NDArray[np.float32]:
        """Returns codes of skills, one-hot, float32 (N, skills).

        Raises:
            InvalidInput: There is no such skill.
        """
        unknown = sum(goal not in self.skills for goal in goals)
        if unknown:
            raise InvalidInput(
                f"Skills must be among {', '.join(self.skills)}; {unknown} of {len(goals)} are others.",
                field="goal",
                hint="Ask the model for its skills: get-spec.",
            )
        return np.eye(len(self.skills), dtype=np.float32)[[self.skills.index(goal) for goal in goals]]

    @torch.inference_mode()
    def step(
        self,
        frames: npt.NDArray[np.uint8],
        goals: npt.NDArray[np.float32],
        previous: npt.NDArray[Any],
        memory: npt.NDArray[np.float32],
    ) -> Step:
        """Tells whether skills have ended, and acts as they would.

        Args:
            frames: uint8 (B, H, W, C).
            goals: float32 (B, skills), from `encode_goals`.
            previous: The actions executed last, float32 (B, A), zeros for none, or int64 (B, 1), -1 for none.
            memory: float32 (B, M), zeros where a skill begins.
        """
        hidden, cell = self._load(memory)[None].chunk(2, dim=2)  # (1, B, M / 2)
        actions, end, after = self._network(
            self._network.image(self._load(frames))[:, None],
            self._load(goals),
            self._load(previous)[:, None],
            (hidden.contiguous(), cell.contiguous()),
        )
        chosen = actions.argmax(dim=3) if self.action_choices else actions.clamp(-1, 1)  # (B, 1, A)
        return Step(
            actions=chosen.cpu().numpy(),
            reached=end[:, 0].sigmoid().cpu().numpy(),
            memory=torch.cat(after, dim=2)[0].cpu().numpy(),
        )

    def _load(self, array: npt.NDArray[Any]) -> torch.Tensor:
        """Returns a copy on the network's device: arrays that came over a wire cannot be written to."""
        return torch.tensor(array, device=self._device)


def load(folder: Path, device: str) -> SkillsPolicy:
    """Returns the skills in a folder.

    Args:
        folder: Written by `freerein.learning.model_files.export`; read as untrusted.
        device: `auto`, `cpu` or `cuda:N`.

    Raises:
        InvalidInput: A file is missing, or is not what a fit writes.
    """
    network = model_files.load_model(folder, SkillsSpec, SkillsNetwork, device=device)
    return SkillsPolicy(network, Handshake.from_card(model_files.read_card(folder)))
