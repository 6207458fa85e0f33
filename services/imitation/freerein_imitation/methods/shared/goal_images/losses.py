"""Training of policies for goal images, and of the goal recognizer, from frames and executed actions alone."""

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, TypeVar

import numpy as np
import torch
from torch import Tensor

from freerein.learning import weights
from freerein.learning.learner import Items, Learner, Losses
from freerein.learning.train_state import TrainState
from freerein.learning.trajectories import Trajectories
from freerein_imitation.methods.shared.frame_features import fit_in_distribution
from freerein_imitation.methods.shared.goal_images.config import GoalImagesConfig
from freerein_imitation.methods.shared.goal_images.network import GoalImagesNetwork, GoalImagesSpec
from freerein_imitation.methods.shared.goal_images.recognizer_losses import (
    reached_threshold,
    recognized_ahead,
    sampled_recognizer_loss,
)
from freerein_imitation.methods.shared.goal_images.relabelling import RelabelledSlices, sample_slices
from freerein_imitation.methods.shared.goal_images.stored_recognizer import StoredRecognizer

N = TypeVar("N", bound=GoalImagesNetwork)

_NORMALISATION_FRAMES = 2000
_EVALUATION_WINDOWS = 192
_REACHED = {"stop_loss", "recognizer_loss"}


class PolicyLosses(NamedTuple):
    """Losses of a policy on slices, float () each.

    Attributes:
        action: Action loss, eq. 3.2.
        auxiliary: Other terms that are trained with it, 0 for none.
        stop: Loss of the policy's own `stop`; None where a recognizer tells that a goal is reached.
    """

    action: Tensor
    auxiliary: Tensor
    stop: Tensor | None = None


@dataclass(frozen=True, eq=False)
class GoalImagesLearner(Learner[N]):
    """Base of the learners of networks for goal images; an item is a window of a trajectory.

    Attributes:
        stored: The recognizer that is copied; None for one that is trained with the policy, or for none.
    """

    config: GoalImagesConfig
    spec: GoalImagesSpec
    training: Trajectories
    validation: Trajectories
    fingerprint: str
    device: torch.device
    stored: StoredRecognizer | None = None

    @abstractmethod
    def network(self) -> N:
        """Returns an untrained network."""

    @abstractmethod
    def policy_losses(self, network: N, slices: RelabelledSlices) -> PolicyLosses:
        """Returns the losses of a network's policy on slices."""

    @property
    def max_steps_per_goal(self) -> int:
        """Control steps after which a goal is abandoned."""
        return 2 * self.config.max_goal_steps

    @cached_property
    def _windows(self) -> Items:
        return self.training.windows(self.config.max_goal_steps)

    @property
    def size(self) -> int:
        """Windows in an epoch."""
        return len(self._windows)

    def init(self, generator: torch.Generator) -> TrainState[N]:
        """Returns the state before the first update."""
        network = self.network()
        weights.initialise(network, generator=generator)
        frames = self.training.sample_frames(_NORMALISATION_FRAMES)
        network.fit_normalisation(frames, generator=generator)
        if self.stored is not None and network.recognizer is not None:
            network.recognizer.load_state_dict(self.stored.weights)
            network.recognizer.requires_grad_(False)
        return TrainState.with_adam(network.to(self.device), self.config.lr, generator=generator)

    def loss(self, state: TrainState[N], items: Items) -> Losses:
        """Returns the losses of some windows."""
        return self._losses(state.network, self.training, self._windows[items].tolist(), state.rng())

    def evaluate(self, state: TrainState[N]) -> float:
        """Returns the action loss (eq. 3.2) plus the recognizer's, if one is trained, on validation trajectories."""
        return without_auxiliary(self.validation_losses(state.network)).item()

    @torch.no_grad()
    def validation_losses(self, network: N) -> Losses:
        """Returns the mean losses on validation trajectories, on the same slices and pairs each time."""
        rng, items = np.random.default_rng(self.config.seed), self.validation.windows(self.config.max_goal_steps)
        items = items[:: math.ceil(len(items) / _EVALUATION_WINDOWS)]
        batches = np.array_split(items, math.ceil(len(items) / self.config.batch_size))
        parts = [self._losses(network, self.validation, batch.tolist(), rng) for batch in batches]
        return {name: torch.stack([part[name] for part in parts]).mean() for name in parts[0]}

    def calibrate(self, network: N) -> None:
        """Fits the network's in-distribution score, to training frames and to held-out ones with goals ahead."""
        reached = self.reached_ahead(network, np.random.default_rng(self.config.seed))
        fit_in_distribution(network, self.training, self.validation, reached, self.device)

    def reached_ahead(self, network: N, rng: np.random.Generator) -> Tensor:
        """Returns the probability that each held-out frame is at a goal ahead of it, float32 (N,)."""
        if network.recognizer is None:
            raise TypeError("A network without a recognizer needs a method of its own.")
        return recognized_ahead(network.recognizer, self.validation, rng, far_steps=self.config.far_steps)

    def reached_threshold(self, network: N) -> float:
        """Returns the probability from which a goal counts as reached."""
        if self.stored is not None:
            return self.stored.threshold
        if network.recognizer is None:
            raise TypeError("A network without a recognizer needs a method of its own.")
        return reached_threshold(network.recognizer, self.validation)

    def _slices(self, trajectories: Trajectories, items: Sequence[int], rng: np.random.Generator) -> RelabelledSlices:
        """Returns slices of random windows of some trajectories."""
        steps = (self.config.min_goal_steps, self.config.max_goal_steps)
        return sample_slices(trajectories, items, rng, steps=steps, device=self.device)

    def _losses(self, network: N, trajectories: Trajectories, items: Sequence[int], rng: np.random.Generator) -> Losses:
        """Returns the losses on slices and frames sampled from some trajectories."""
        slices = self._slices(trajectories, items, rng)
        action, auxiliary, stop = self.policy_losses(network, slices)
        losses = {"train_loss": action + auxiliary, "action_loss": action}
        if stop is not None:
            losses["stop_loss"] = stop
        elif network.recognizer is not None and self.stored is None:
            close, far = self.config.close_steps, self.config.far_steps
            losses["recognizer_loss"] = sampled_recognizer_loss(
                network.recognizer, trajectories, items, rng, close_steps=close, far_steps=far, device=self.device
            )
        for name in losses.keys() & _REACHED:
            losses["train_loss"] = losses["train_loss"] + losses[name]
        return losses


def without_auxiliary(losses: Losses) -> Tensor:
    """Returns the action loss and that of what tells that a goal is reached, float ()."""
    return sum((losses[name] for name in losses.keys() & _REACHED), start=losses["action_loss"])
