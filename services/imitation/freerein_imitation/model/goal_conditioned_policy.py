"""A trained goal-conditioned policy and its recognizer as the service knows them: numpy in, numpy out."""

from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freerein.learning import model_files
from freerein_imitation.model import action_code
from freerein_imitation.model.goal_conditioned import GoalConditionedNetwork, GoalConditionedSpec
from freerein_imitation.model.handshake import Handshake
from freerein_imitation.model.recognizer import closeness
from freerein_imitation.model.step import Step

_FRAMES_AT_ONCE = 256


class GoalConditionedPolicy:
    """Acts towards goal images. The network's device is where it computes; arrays are on the CPU.

    Args:
        network: Trained.
        handshake: What it is to a robot.

    Attributes:
        kind: `goal_conditioned`.
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
        memory_size: M, floats of recurrent memory: hidden state and cell.
        reached_threshold: A goal is reached when the probability that it is, is at least this.
        max_steps_per_goal: Control steps after which a goal is given up, unless a request says otherwise.
    """

    kind: Literal["goal_conditioned"] = "goal_conditioned"
    horizon = 1
    skills: tuple[str, ...] = ()

    def __init__(self, network: GoalConditionedNetwork, handshake: Handshake) -> None:
        spec = network.spec
        self.camera = spec.camera
        self.height, self.width, self.channels = spec.height, spec.width, spec.channels
        self.action = handshake.action
        self.action_size, self.action_choices = spec.action_size, spec.action_choices
        self.control_dt_s = handshake.control_dt_s
        self.memory_size = 2 * spec.hidden
        self.reached_threshold = handshake.reached_threshold
        self.max_steps_per_goal = handshake.max_steps_per_goal
        self._features = spec.features
        self._network = network.eval()
        self._device = next(network.parameters()).device

    @torch.inference_mode()
    def encode_goals(self, goals: npt.NDArray[np.uint8]) -> npt.NDArray[np.float32]:
        """Returns codes of goal images, float32 (N, G): what policy and recognizer see in each.

        Args:
            goals: uint8 (N, H, W, C).
        """
        windows = [
            self._load(goals[start : start + _FRAMES_AT_ONCE]) for start in range(0, len(goals), _FRAMES_AT_ONCE)
        ]
        codes: npt.NDArray[np.float32] = torch.cat([self._see(window) for window in windows]).cpu().numpy()
        return codes

    @torch.inference_mode()
    def step(
        self,
        frames: npt.NDArray[np.uint8],
        goals: npt.NDArray[np.float32],
        previous: npt.NDArray[Any],
        memory: npt.NDArray[np.float32],
    ) -> Step:
        """Judges observations against their goals, and acts for these goals.

        Args:
            frames: uint8 (B, H, W, C).
            goals: float32 (B, G), from `encode_goals`.
            previous: The actions executed last, float32 (B, A), zeros for none, or int64 (B, 1), -1 for none.
            memory: float32 (B, M), zeros where a goal begins.
        """
        goal = self._load(goals)
        hidden, cell = self._load(memory)[None].chunk(2, dim=2)  # (1, B, hidden)
        seen = self._see(self._load(frames))  # (B, G)
        scores, after = self._network.policy(
            seen[:, None, : self._features],
            goal[:, : self._features],
            self._load(previous)[:, None],
            (hidden.contiguous(), cell.contiguous()),
        )
        reached = closeness(seen[:, self._features :], goal[:, self._features :]).sigmoid()
        return Step(
            actions=action_code.decode(scores, choices=self.action_choices).cpu().numpy(),
            reached=reached.cpu().numpy(),
            memory=torch.cat(after, dim=2)[0].cpu().numpy(),
        )

    def _see(self, frames: Tensor) -> Tensor:
        """Returns the policy's features and the recognizer's embedding, float32 (N, G)."""
        return torch.cat([self._network.policy.image(frames), self._network.recognizer(frames)], dim=1)

    def _load(self, array: npt.NDArray[Any]) -> Tensor:
        """Returns a copy on the network's device: arrays that came over a wire cannot be written to."""
        return torch.tensor(array, device=self._device)


def load(folder: Path, device: str) -> GoalConditionedPolicy:
    """Returns the goal-conditioned policy in a folder.

    Args:
        folder: Written by a fit; read as untrusted.
        device: `auto`, `cpu` or `cuda:N`.

    Raises:
        InvalidInput: A file is missing, or is not what a fit writes.
    """
    network = model_files.load_model(folder, GoalConditionedSpec, GoalConditionedNetwork, device=device)
    return GoalConditionedPolicy(network, Handshake.from_card(model_files.read_card(folder)))
