"""The goal recognizer of section 3.2 as a fit of its own, which the fits of several policies can copy.

Served by itself it holds the robot and tells when a goal image is reached, for whoever else moves the robot.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import torch
from torch import Tensor

from freerein.config import bounded, one_of
from freerein.data import read_teachers
from freerein.errors import InvalidInput
from freerein.learning import weights
from freerein.learning.encoders import ENCODERS, FrameTensors
from freerein.learning.fit_config import DatasetFitConfig
from freerein.learning.fit_dataset import FitDataset
from freerein.learning.inputs import spec_of
from freerein.learning.learner import Items, Learner, Losses
from freerein.learning.methods import Method
from freerein.learning.train_state import TrainState
from freerein.learning.training_loop import FitResult
from freerein.learning.trajectories import Trajectories
from freerein_imitation.methods.shared.frame_features import fit_in_distribution
from freerein_imitation.methods.shared.goal_images.recognizer import (
    GoalRecognizerNetwork,
    GoalRecognizerSpec,
    proximity_logit,
)
from freerein_imitation.methods.shared.goal_images.recognizer_losses import (
    reached_threshold,
    recognized_ahead,
    sampled_recognizer_loss,
)
from freerein_imitation.methods.shared.supervision import supervision_of
from freerein_imitation.model.policy import ControlSpec
from freerein_imitation.model.torch_policy import StepInputs, StepOutputs, TorchPolicy, confidence, loader

_NORMALISATION_FRAMES = 2000
_VALIDATION_BATCHES = 8


@dataclass(frozen=True)
class GoalRecognizerConfig(DatasetFitConfig):
    """Configuration of a fit of a goal recognizer; validation trajectories choose the reached threshold, too.

    Attributes:
        encoder: Image encoder.
        close_steps: Frames at most so many actions apart are positive pairs.
        far_steps: Frames of one trajectory more actions apart than that are negative pairs.
        batch_size: Windows per update; each gives four pairs of close frames.
        embedding_size: Size of the embeddings, and image features per camera.

    Raises:
        InvalidInput: `close_steps` is above `far_steps`.
    """

    encoder: str = one_of(ENCODERS, "spatial")
    close_steps: int = bounded(2, least=1, most=1000)
    far_steps: int = bounded(15, least=1, most=10_000)
    steps: int = bounded(300, least=1, most=10_000_000)
    batch_size: int = bounded(24, least=1, most=1024)
    lr: float = bounded(6e-3, least=1e-7, most=1.0)
    embedding_size: int = bounded(64, least=2, most=1024)
    evaluate_every: int = bounded(50, least=1, most=1_000_000)

    def __post_init__(self) -> None:
        if self.close_steps > self.far_steps:
            raise InvalidInput(
                f"`close_steps` must not be above `far_steps`; got {self.close_steps} and {self.far_steps}.",
                field="config.close_steps",
            )


class GoalRecognizerPolicy(TorchPolicy[GoalRecognizerNetwork]):
    """Holds, and tells whether a goal image is reached."""

    def __init__(self, network: GoalRecognizerNetwork, control: ControlSpec) -> None:
        super().__init__(network, control, goal_form="images")

    def encode_images(self, images: FrameTensors) -> Tensor:
        """Returns embeddings, float32 (N, G), of goal images by camera, uint8 (N, H, W, C)."""
        embeddings: Tensor = self._network.recognizer(images)
        return embeddings

    def _step(self, inputs: StepInputs) -> StepOutputs:
        reached = proximity_logit(self._network.recognizer(inputs.frames), inputs.goals).sigmoid()
        return StepOutputs(self._hold(inputs)[:, None], reached, inputs.recurrent, confidence(reached))

    def _hold(self, inputs: StepInputs) -> Tensor:
        """Returns actions that hold, (B, A): of targets the last one."""
        if self.spec.action.absolute:
            return inputs.previous
        return self._tensor(np.tile(self.spec.action.nearest_to_hold(), (len(inputs.previous), 1)))


@dataclass(frozen=True, eq=False)
class GoalRecognizerLearner(Learner[GoalRecognizerNetwork]):
    """The learner; an item is a window of a trajectory."""

    config: GoalRecognizerConfig
    spec: GoalRecognizerSpec
    training: Trajectories
    validation: Trajectories
    fingerprint: str
    device: torch.device

    @cached_property
    def _windows(self) -> Items:
        return self.training.windows(self.config.far_steps)

    @property
    def size(self) -> int:
        """Windows in an epoch."""
        return len(self._windows)

    def init(self, generator: torch.Generator) -> TrainState[GoalRecognizerNetwork]:
        """Returns the state before the first update."""
        network = GoalRecognizerNetwork(self.spec)
        weights.initialise(network, generator=generator)
        frames = self.training.sample_frames(_NORMALISATION_FRAMES)
        network.recognizer.encoder.fit_normalisation(frames, generator=generator)
        return TrainState.with_adam(network.to(self.device), self.config.lr, generator=generator)

    def loss(self, state: TrainState[GoalRecognizerNetwork], items: Items) -> Losses:
        """Returns the loss on frames of some windows."""
        return {"train_loss": self._loss(state.network, self.training, self._windows[items].tolist(), state.rng())}

    @torch.no_grad()
    def evaluate(self, state: TrainState[GoalRecognizerNetwork]) -> float:
        """Returns the mean loss on validation trajectories, on the same pairs each time."""
        rng, windows = np.random.default_rng(self.config.seed), self.validation.windows(self.config.far_steps)
        spread = np.linspace(0, len(windows) - 1, _VALIDATION_BATCHES * self.config.batch_size).astype(np.int64)
        batches = windows[spread].reshape(self.config.batch_size, _VALIDATION_BATCHES).T  # each of all trajectories
        parts = [self._loss(state.network, self.validation, batch.tolist(), rng) for batch in batches]
        return torch.stack(parts).mean().item()

    def calibrate(self, network: GoalRecognizerNetwork) -> None:
        """Fits the network's in-distribution score, to training frames and to held-out ones with goals ahead."""
        rng, far = np.random.default_rng(self.config.seed), self.config.far_steps
        reached = recognized_ahead(network.recognizer, self.validation, rng, far_steps=far)
        fit_in_distribution(network, self.training, self.validation, reached, self.device)

    def _loss(
        self,
        network: GoalRecognizerNetwork,
        trajectories: Trajectories,
        items: Sequence[int],
        rng: np.random.Generator,
    ) -> torch.Tensor:
        close, far = self.config.close_steps, self.config.far_steps
        return sampled_recognizer_loss(
            network.recognizer, trajectories, items, rng, close_steps=close, far_steps=far, device=self.device
        )


def _spec(source: FitDataset, config: GoalRecognizerConfig) -> GoalRecognizerSpec:
    cameras, action = source.cameras(config.cameras), source.dataset.spec.action
    return spec_of(config, GoalRecognizerSpec, cameras=cameras, action=action)


def _prepare(source: FitDataset, config: GoalRecognizerConfig, device: torch.device) -> GoalRecognizerLearner:
    training, validation = source.trajectories(config.cameras).split(
        fraction=config.validation_fraction, seed=config.seed, min_length=2
    )
    fingerprint = source.dataset.fingerprint
    return GoalRecognizerLearner(config, _spec(source, config), training, validation, fingerprint, device)


def _card(
    source: FitDataset, learner: GoalRecognizerLearner, fitted: FitResult[GoalRecognizerNetwork]
) -> dict[str, Any]:
    threshold = reached_threshold(fitted.network.recognizer, learner.validation)
    control = ControlSpec(source.dataset.spec.control_dt_s, threshold, 2 * learner.config.far_steps)
    own = "images of exploration, and how many actions lie between them"
    return {**control.to_card(), **supervision_of(own, read_teachers(source.root))}


_load = loader(GoalRecognizerPolicy, GoalRecognizerSpec, GoalRecognizerNetwork)
METHOD = Method(GoalRecognizerConfig, _spec, _prepare, _card, _load)
