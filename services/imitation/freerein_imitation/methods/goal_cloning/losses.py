"""Training of goal-conditioned behavioural cloning and its goal recognizer, from frames and executed actions alone."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from freerein.learning import weights
from freerein.learning.augmentation import delayed
from freerein.learning.learner import Items, Learner, Losses
from freerein.learning.train_state import TrainState
from freerein.learning.trajectories import Trajectories
from freerein_imitation.methods.goal_cloning.change_head import change_data, fit_change_head, time_logits
from freerein_imitation.methods.goal_cloning.config import GoalCloningConfig
from freerein_imitation.methods.goal_cloning.goal_windows import (
    ChangePairs,
    GoalPairs,
    GoalWindows,
    Places,
    lookalikes,
    sample_change_pairs,
    sample_goal_pairs,
    sample_windows,
    window_steps,
)
from freerein_imitation.methods.goal_cloning.network import GoalCloningNetwork, GoalCloningSpec
from freerein_imitation.methods.goal_cloning.odometry_check import odometry_warnings
from freerein_imitation.methods.goal_cloning.positive_unlabelled import positive_unlabelled_calibration
from freerein_imitation.methods.shared import action_bins
from freerein_imitation.methods.shared.frame_features import (
    encode_trajectory,
    fit_in_distribution,
    trajectory_statistics,
)
from freerein_imitation.methods.shared.goal_images.recognizer_losses import goals_ahead
from freerein_imitation.methods.shared.losses import action_cross_entropy
from freerein_imitation.methods.shared.views import SharedView

_NORMALISATION_FRAMES = 1500
_EVALUATION_WINDOWS = 96
_ODOMETRY_WEIGHT, _CHANGE_WEIGHT = 0.3, 1.0
_LEAST_ALIKE_SHARE_IN_WINDOWS = 0.03  # of pairs close in time that look less alike than a changed scene
_HEAD_UPDATES = 0.6  # of the head for changes alone, per optimiser step
_UNCHANGED_SHARE = 0.75  # of pairs of frames at nearby places that are far in time, as calibration takes it
_NORMAL_MAD = 1.48  # standard deviations per median absolute deviation of a normal distribution
_SPREAD_SHARE = 0.5  # of the residuals' spread; the rest is the lag of the robot behind its actions
_AUGMENTED_SHARE = 0.5  # of the updates, once augmentation begins
_HEAD_VIEWS = 5  # that the head for changes learns from, beside frames as they are


@dataclass(frozen=True, eq=False)
class GoalCloningLearner(Learner[GoalCloningNetwork]):
    """Learner of the network; an item is a window of a trajectory."""

    config: GoalCloningConfig
    spec: GoalCloningSpec
    training: Trajectories
    validation: Trajectories
    fingerprint: str
    device: torch.device

    @cached_property
    def _training_alike(self) -> list[Places]:
        return _lookalikes(self.training, self.config)

    @cached_property
    def _validation_alike(self) -> list[Places]:
        return _lookalikes(self.validation, self.config)

    @cached_property
    def _windows(self) -> Places:
        return self.training.windows(window_steps(self.config.max_goal_steps))

    @property
    def size(self) -> int:
        """Windows in an epoch."""
        return len(self._windows)

    def init(self, generator: torch.Generator) -> TrainState[GoalCloningNetwork]:
        """Returns the state before the first update."""
        network = GoalCloningNetwork(self.spec)
        weights.initialise(network, generator=generator)
        frames = self.training.sample_frames(_NORMALISATION_FRAMES)
        network.encoder.fit_normalisation(frames, generator=generator)
        return TrainState.with_adam(network.to(self.device), self.config.lr, generator=generator)

    def loss(self, state: TrainState[GoalCloningNetwork], items: Items) -> Losses:
        """Returns the losses of some windows."""
        rng = state.rng()
        batch = self._sample(self.training, self._training_alike, self._windows[items].tolist(), rng)
        strength = delayed(self.config.augmentation, step=state.step, steps=self.config.steps)
        if strength and rng.random() < _AUGMENTED_SHARE:
            batch = replace(batch, frames=self._view(strength, state.generator).of(batch.frames))
        losses = self._losses(state.network, batch, rng)
        return {"train_loss": _total(losses), **losses}

    def evaluate(self, state: TrainState[GoalCloningNetwork]) -> float:
        """Returns the sum of the losses on validation trajectories, on frames as they are and augmented ones."""
        strengths = sorted({0.0, self.config.augmentation})
        losses = [_total(self.validation_losses(state.network, strength=each)).item() for each in strengths]
        return sum(losses) / len(losses)

    @torch.no_grad()
    def validation_losses(self, network: GoalCloningNetwork, *, strength: float = 0.0) -> Losses:
        """Returns the mean losses on validation trajectories, on the same windows and pairs each time.

        With a strength of the augmentation, each batch is seen in a view of its own.
        """
        rng, generator = np.random.default_rng(self.config.seed), torch.Generator().manual_seed(self.config.seed)
        parts = []
        for batch in self._validation_batches(rng):
            seen = replace(batch, frames=self._view(strength, generator).of(batch.frames))
            parts.append(self._losses(network, seen, rng))
        return {name: torch.stack([part[name] for part in parts]).mean() for name in parts[0]}

    def warnings(self, network: GoalCloningNetwork) -> list[str]:
        """Returns a warning where places do not tell continuous actions of validation trajectories."""
        if self.spec.action.choices:
            return []
        rng = np.random.default_rng(self.config.seed)
        windows = self._validation_batches(rng)
        return odometry_warnings(network, windows, rng, max_goal_steps=self.config.max_goal_steps)

    @torch.no_grad()
    def calibrate(self, network: GoalCloningNetwork) -> None:
        """Fits the head for changes, then the recognizer's probability and in-distribution score to held-out frames."""
        rng, config = np.random.default_rng(self.config.seed), self.config
        recognizer, reached = network.recognizer, []
        features = [self._encoded(network, self.validation, view) for view in self._head_views()]
        if not self.spec.action.choices:
            recognizer.spread.copy_(self._spread(network, features))
        self._fit_change_head(network, features)
        for each in features[0]:
            reached.append(recognizer(each, each[goals_ahead(len(each), rng, far_steps=config.far_steps)]))
        fit_in_distribution(
            network,
            self.training,
            self.validation,
            torch.cat(reached),
            self.device,
            augmentation=config.augmentation,
            seed=config.seed,
        )

    def _view(self, strength: float, generator: torch.Generator) -> SharedView:
        return SharedView.draw(self.spec.cameras, strength=strength, generator=generator)

    def _head_views(self) -> list[SharedView]:
        """Returns the views in which the recognizer compares frames: as they are, then augmented ones."""
        generator, strength = torch.Generator().manual_seed(self.config.seed), self.config.augmentation
        strengths = [0.0, *[strength] * (_HEAD_VIEWS if strength else 0)]
        return [self._view(each, generator) for each in strengths]

    def _encoded(self, network: GoalCloningNetwork, trajectories: Trajectories, view: SharedView) -> list[Tensor]:
        """Returns the features of all frames in a view, by trajectory: float32 (T, D)."""
        items = range(len(trajectories))
        return [encode_trajectory(network.encoder, trajectories, item, view=view) for item in items]

    def _validation_batches(self, rng: np.random.Generator) -> list[GoalWindows]:
        items = self.validation.windows(window_steps(self.config.max_goal_steps))
        items = items[:: math.ceil(len(items) / _EVALUATION_WINDOWS)]
        chunks = np.array_split(items, math.ceil(len(items) / self.config.batch_size))
        return [self._sample(self.validation, self._validation_alike, chunk.tolist(), rng) for chunk in chunks]

    def _sample(
        self, trajectories: Trajectories, alike: Sequence[Places], items: Sequence[int], rng: np.random.Generator
    ) -> GoalWindows:
        steps = self.config.max_goal_steps
        return sample_windows(trajectories, alike, items, rng, max_goal_steps=steps, device=self.device)

    def _losses(self, network: GoalCloningNetwork, batch: GoalWindows, rng: np.random.Generator) -> Losses:
        """Returns the losses on pairs sampled from some windows."""
        features = network.encoder(batch.frames)  # (N, D)
        pairs = sample_goal_pairs(batch, rng, max_goal_steps=self.config.max_goal_steps)
        at, goals, before = pairs.observations, pairs.goals, pairs.before
        logits = network(features[at], features[goals], features[before], batch.previous[at])
        executed = action_bins.encode(batch.actions[at], choices=self.spec.action.choices)  # (P, A, categories)
        changes = self._change_pairs(network, batch, features, rng)
        unchanged = network.recognizer.unchanged_logit(features[changes.first], features[changes.second])
        return {
            "action_loss": action_cross_entropy(logits, executed).mean(),
            "odometry_loss": self._odometry_loss(network, features, batch, pairs),
            "change_loss": self._change_loss(unchanged, changes),
        }

    def _odometry_loss(
        self, network: GoalCloningNetwork, features: Tensor, batch: GoalWindows, pairs: GoalPairs
    ) -> Tensor:
        """Returns how far differences of places are from sums of actions; 0 where actions are discrete: float ()."""
        if self.spec.action.choices:
            return features.new_zeros(())
        places = network.recognizer.places(features)  # (N, A)
        moved = batch.odometer[pairs.goals] - batch.odometer[pairs.observations]
        return absolute_error(places[pairs.goals] - places[pairs.observations], moved).mean()

    def _change_loss(self, unchanged: Tensor, changes: ChangePairs) -> Tensor:
        """Returns the loss, float (), of logits that nothing changed, float32 (P,).

        Of the pairs far in time, those count as changed that look less alike than nearly all that are close in time.
        """
        is_close, is_far = (torch.from_numpy(each).to(self.device) for each in (changes.is_close, changes.is_far))
        if not is_close.any():
            return unchanged.new_zeros(())
        least_alike = unchanged[is_close].detach().quantile(_LEAST_ALIKE_SHARE_IN_WINDOWS)
        counts = ~is_far | (unchanged.detach() < least_alike)
        return functional.binary_cross_entropy_with_logits(unchanged[counts], is_close[counts].float())

    def _change_pairs(
        self, network: GoalCloningNetwork, batch: GoalWindows, features: Tensor, rng: np.random.Generator
    ) -> ChangePairs:
        recognizer, config = network.recognizer, self.config
        places = (recognizer.places(features.detach()) / recognizer.tolerance).detach().cpu().numpy()  # (N, A)
        return sample_change_pairs(batch, places, rng, close_steps=config.close_steps, far_steps=config.far_steps)

    def _fit_change_head(self, network: GoalCloningNetwork, held_out: Sequence[Sequence[Tensor]]) -> None:
        """Trains the recognizer's head for changes on all frames, and calibrates it by features of held-out ones.

        `held_out` are those of each trajectory in each view.
        """
        recognizer, config = network.recognizer, self.config
        steps = {"close_steps": config.close_steps, "far_steps": config.far_steps, "seed": config.seed}
        training = [change_data(recognizer, self._encoded(network, self.training, view)) for view in self._head_views()]
        with torch.enable_grad():
            updates = math.ceil(_HEAD_UPDATES * config.steps)
            fit_change_head(recognizer, training, updates=updates, **steps)
        found = [time_logits(recognizer, change_data(recognizer, each), **steps) for each in held_out]
        close, far = (torch.cat(each) for each in zip(*found, strict=True))
        if len(close) and len(far):
            gain, bias = positive_unlabelled_calibration(close, far, share=_UNCHANGED_SHARE)
            recognizer.gain.fill_(gain)
            recognizer.bias.fill_(bias)

    def _spread(self, network: GoalCloningNetwork, features: Sequence[Sequence[Tensor]]) -> Tensor:
        """Returns how far places are from the actions, float32 (A,), by features of validation trajectories by view."""
        residuals = []
        for view in features:
            for item, each in enumerate(view):
                executed = torch.tensor(self.validation.actions[item], device=self.device)
                residuals.append(network.recognizer.places(each).diff(dim=0) - executed[:-1])
        return _SPREAD_SHARE * _NORMAL_MAD * torch.cat(residuals).abs().median(dim=0).values


def _total(losses: Losses) -> Tensor:
    """Returns the sum that is minimised, float ()."""
    return losses["action_loss"] + _ODOMETRY_WEIGHT * losses["odometry_loss"] + _CHANGE_WEIGHT * losses["change_loss"]


def _lookalikes(trajectories: Trajectories, config: GoalCloningConfig) -> list[Places]:
    statistics = torch.split(trajectory_statistics(trajectories), trajectories.lengths().tolist())
    return [lookalikes(each, far_steps=config.far_steps) for each in statistics]


def absolute_error(predicted: Tensor, target: Tensor) -> Tensor:
    """Returns the mean absolute error over the last axis of floats (..., D): float (...).

    Its minimum is the median of demonstrations.
    """
    return (predicted - target).abs().mean(dim=-1)
