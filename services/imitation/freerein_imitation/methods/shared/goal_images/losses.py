"""Training of policies for goal images, and of the goal recognizer, from frames and executed actions alone."""

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from freerein.learning import weights
from freerein.learning.learner import Items, Learner, Losses
from freerein.learning.train_state import TrainState
from freerein.learning.trajectories import Trajectories
from freerein_imitation.methods.shared.frame_features import encode_trajectory, fit_in_distribution
from freerein_imitation.methods.shared.goal_images.config import GoalImagesConfig
from freerein_imitation.methods.shared.goal_images.network import (
    GoalImagesNetwork,
    GoalImagesSpec,
    GoalRecognizer,
    proximity_logit,
)
from freerein_imitation.methods.shared.goal_images.relabelling import (
    RelabelledSlices,
    sample_recognizer_batch,
    sample_slices,
)
from freerein_imitation.methods.shared.losses import masked_mean

N = TypeVar("N", bound=GoalImagesNetwork)

_NORMALISATION_FRAMES = 2000
_EVALUATION_WINDOWS = 192
_THRESHOLD_FRAMES = 256


@dataclass(frozen=True, eq=False)
class GoalImagesLearner(Learner[N]):
    """Base of the learners of networks for goal images; an item is a window of a trajectory."""

    config: GoalImagesConfig
    spec: GoalImagesSpec
    training: Trajectories
    validation: Trajectories
    fingerprint: str
    device: torch.device

    @abstractmethod
    def network(self) -> N:
        """Returns an untrained network."""

    @abstractmethod
    def policy_losses(self, network: N, slices: RelabelledSlices) -> tuple[Tensor, Tensor]:
        """Returns the action loss of a network on slices, eq. 3.2, and its auxiliary losses, float () each."""

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
        return TrainState.with_adam(network.to(self.device), self.config.lr, generator=generator)

    def loss(self, state: TrainState[N], items: Items) -> Losses:
        """Returns the losses of some windows."""
        return self._losses(state.network, self.training, self._windows[items].tolist(), state.rng())

    def evaluate(self, state: TrainState[N]) -> float:
        """Returns the action loss (eq. 3.2) plus the recognizer's on validation trajectories."""
        losses = self.validation_losses(state.network)
        return (losses["action_loss"] + losses["recognizer_loss"]).item()

    @torch.no_grad()
    def validation_losses(self, network: N) -> Losses:
        """Returns the mean losses on validation trajectories, on the same slices and pairs each time."""
        rng, items = np.random.default_rng(self.config.seed), self.validation.windows(self.config.max_goal_steps)
        items = items[:: math.ceil(len(items) / _EVALUATION_WINDOWS)]
        batches = np.array_split(items, math.ceil(len(items) / self.config.batch_size))
        parts = [self._losses(network, self.validation, batch.tolist(), rng) for batch in batches]
        return {name: torch.stack([part[name] for part in parts]).mean() for name in parts[0]}

    @torch.no_grad()
    def calibrate(self, network: N) -> None:
        """Fits the network's in-distribution score, to training frames and to held-out ones with goals ahead."""
        rng, reached = np.random.default_rng(self.config.seed), []
        for item, length in enumerate(self.validation.lengths().tolist()):
            embeddings = encode_trajectory(network.recognizer, self.validation, item)  # (T, embedding_size)
            ahead = np.arange(length) + rng.integers(1, self.config.far_steps, length, endpoint=True)
            goals = embeddings[np.minimum(ahead, length - 1)]
            reached.append(proximity_logit(embeddings, goals).sigmoid())  # (T,)
        fit_in_distribution(network, self.training, self.validation, torch.cat(reached), self.device)

    def _slices(self, trajectories: Trajectories, items: Sequence[int], rng: np.random.Generator) -> RelabelledSlices:
        """Returns slices of random windows of some trajectories."""
        steps = (self.config.min_goal_steps, self.config.max_goal_steps)
        return sample_slices(trajectories, items, rng, steps=steps, device=self.device)

    def _losses(self, network: N, trajectories: Trajectories, items: Sequence[int], rng: np.random.Generator) -> Losses:
        """Returns the losses on slices and frames sampled from some trajectories."""
        config = self.config
        slices = self._slices(trajectories, items, rng)
        batch = sample_recognizer_batch(trajectories, items, rng, close_steps=config.close_steps, device=self.device)
        action, auxiliary = self.policy_losses(network, slices)
        embeddings = network.recognizer(batch.frames)  # (N, embedding_size)
        logits = proximity_logit(embeddings[:, None], embeddings)  # (N, N)
        pairs = batch.pairs(close_steps=config.close_steps, far_steps=config.far_steps)
        recognizer = recognizer_loss(logits, *pairs)
        return {"train_loss": action + auxiliary + recognizer, "action_loss": action, "recognizer_loss": recognizer}


@torch.no_grad()
def reached_threshold(recognizer: GoalRecognizer, trajectories: Trajectories) -> float:
    """Returns the recognizer's median probability that frames one action apart are close.

    The threshold that best separates training's pairs is far lower, and would call a goal reached too early.
    At least one of the validation trajectories has 2 timesteps.
    """
    logits = []
    for item in range(len(trajectories)):
        embeddings = encode_trajectory(recognizer, trajectories, item, most=_THRESHOLD_FRAMES)
        logits.append(proximity_logit(embeddings[1:], embeddings[:-1]).cpu().numpy())  # (T - 1,)
    return float(np.median(1 / (1 + np.exp(-np.concatenate(logits)))))


def recognizer_loss(logits: Tensor, close: Tensor, far: Tensor, other_trajectory: Tensor) -> Tensor:
    """Returns the balanced logistic loss of the goal recognizer: float ().

    Close pairs weigh as much as all others; of those, pairs of one trajectory weigh half, since else it would be enough
    to tell scenes apart.

    Args:
        logits: Logits of pairs to be close, float (N, N).
        close: Pairs a few steps apart, bool (N, N).
        far: Pairs of one trajectory that are further apart, bool (N, N).
        other_trajectory: Pairs of different trajectories, bool (N, N).
    """
    negative = functional.softplus(logits)
    others = (masked_mean(negative, far) + masked_mean(negative, other_trajectory)) / 2
    return (masked_mean(functional.softplus(-logits), close) + others) / 2
