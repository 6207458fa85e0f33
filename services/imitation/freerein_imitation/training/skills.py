"""Behavioural cloning of skills from frames, executed actions and predicted skill labels."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn import functional
from torch.nn.utils.rnn import pad_sequence

from freerein.errors import InvalidInput
from freerein.learning import weights
from freerein.learning.config import bounded, one_of
from freerein.learning.encoders import ENCODERS, CameraEncoders
from freerein.learning.fit_config import DatasetFitConfig
from freerein.learning.inputs import spec_of
from freerein.learning.optimiser import fit_step
from freerein.learning.train_state import TrainState
from freerein.learning.trajectories import Trajectories
from freerein.types.common import ActionSpec, Camera
from freerein_imitation import objectives
from freerein_imitation.model import action_bins
from freerein_imitation.model.policy import confidence
from freerein_imitation.model.skills import SkillsNetwork, SkillsSpec
from freerein_imitation.training.frame_features import encode_trajectory, sampled_statistics, segment_statistics
from freerein_imitation.training.skill_segments import (
    SegmentBatch,
    SegmentDataset,
    SkillSegment,
    collate,
    find_segments,
    split_segments,
)

State = TrainState[SkillsNetwork]

TERMINATION_THRESHOLD = 0.5
"""Probability from which on a skill has terminated; the loss gives both classes equal weight."""

_NORMALISATION_FRAMES = 500
_LEAST_STEPS_LEFT = 5
_STEP_LIMIT_FACTOR = 1.5
_STEP_LIMIT_PERCENTILE = 95


@dataclass(frozen=True)
class SkillsConfig(DatasetFitConfig):
    """Configuration of a fit of skills.

    Attributes:
        encoder: Image encoder. `colour_codebook` finds places from few demonstrations, for a camera that does not move.
        min_segment_steps: Shorter segments are taken for label errors, as in section 2.4.
        start_jitter: Timesteps by which a segment's start is moved at random, either way.
        random_start_fraction: Fraction of segments started at a random timestep, so that time alone does not determine
            the action.
        termination_steps: Timesteps after a segment's last in which the termination target stays 1.
        random_shift: Largest random horizontal shift of a frame's contents, with the colour codebook only; 1 is half of
            the frame.
        termination_weight: Weight of the termination loss relative to the action loss.
        batch_size: Segments per update.
        features: Image features per camera; the colour codebook has 5 per colour.
        hidden_size: Units of the hidden layers.
        recurrent_size: Units of the LSTM.
    """

    encoder: str = one_of(ENCODERS, "colour_codebook")
    min_segment_steps: int = bounded(5, least=1, most=1000)
    start_jitter: int = bounded(3, least=0, most=1000)
    random_start_fraction: float = bounded(0.5, least=0.0, most=1.0)
    termination_steps: int = bounded(3, least=0, most=1000)
    random_shift: float = bounded(0.3, least=0.0, most=1.0)
    termination_weight: float = bounded(0.1, least=0.0, most=100.0)
    steps: int = bounded(2500, least=1, most=10_000_000)
    batch_size: int = bounded(12, least=1, most=1024)
    features: int = bounded(160, least=8, most=1280)
    hidden_size: int = bounded(128, least=8, most=1024)
    recurrent_size: int = bounded(64, least=8, most=1024)
    evaluate_every: int = bounded(200, least=1, most=1_000_000)
    checkpoint_every: int = bounded(500, least=1, most=1_000_000)
    log_every: int = bounded(20, least=1, most=1_000_000)


def network_spec(
    config: SkillsConfig, *, cameras: tuple[Camera, ...], action: ActionSpec, skills: tuple[str, ...]
) -> SkillsSpec:
    """Returns the spec of the network for some cameras, actions and skills.

    Raises:
        InvalidInput: Frames, actions or skills are out of bounds.
    """
    return spec_of(config, SkillsSpec, cameras=cameras, action=action, skills=skills)


@dataclass(frozen=True, eq=False)
class SkillsLosses:
    """Loss terms, each float ().

    Attributes:
        action: Over all timesteps of segments.
        termination: Of the termination head.
    """

    action: Tensor
    termination: Tensor


@dataclass(frozen=True, eq=False)
class SkillsLearner:
    """Learner of skills; an item is a segment.

    Attributes:
        config: Configuration.
        spec: Spec of the network.
        encoder: Normalised by the demonstrations' frames. A frozen one has encoded them all.
        training: Training segments.
        validation: Validation segments.
        fingerprint: Fingerprint of the dataset and its labels.
        device: Device to train on.
    """

    config: SkillsConfig
    spec: SkillsSpec
    encoder: CameraEncoders
    training: SegmentDataset
    validation: SegmentDataset
    fingerprint: str
    device: torch.device

    @classmethod
    def prepare(
        cls,
        config: SkillsConfig,
        spec: SkillsSpec,
        demonstrations: Trajectories,
        labels: Sequence[npt.NDArray[np.int64]],
        *,
        fingerprint: str,
        device: torch.device,
    ) -> "SkillsLearner":
        """Returns the learner for labelled demonstrations; a frozen encoder encodes every frame once.

        Args:
            config: Configuration.
            spec: Spec of the network for all skills. Those without a training segment are left out.
            demonstrations: Frames and executed actions.
            labels: By trajectory, the predicted skill at each timestep, int64 (T,).
            fingerprint: Fingerprint of the dataset and its labels.
            device: Device to train on.

        Raises:
            InvalidInput: Segments are of fewer than 2 trajectories, or validation and training share no skill.
        """
        encoder = _normalised_encoder(spec, demonstrations, seed=config.seed)
        features = None if encoder.is_trained else encode(encoder, demonstrations, range(len(demonstrations)))
        segments = find_segments(labels, min_steps=config.min_segment_steps)
        dataset = SegmentDataset(segments, demonstrations, features)
        training, validation = split_segments(dataset, fraction=config.validation_fraction, seed=config.seed)
        trained = sorted({each.skill for each in training.segments})
        training, validation = training.only(trained), validation.only(trained)
        if not len(validation):
            raise InvalidInput(
                "The validation trajectories must show a skill that the training ones show; they show none.",
                field="dataset",
                hint="Record more demonstrations, and label them.",
            )
        spec = replace(spec, skills=tuple(spec.skills[skill] for skill in trained))
        return cls(config, spec, encoder, training, validation, fingerprint, device)

    @property
    def size(self) -> int:
        """Training segments."""
        return len(self.training)

    @property
    def max_steps_per_skill(self) -> int:
        """Control steps after which a skill is abandoned: 1.5 times the 95th percentile of segment lengths."""
        return math.ceil(_STEP_LIMIT_FACTOR * float(np.percentile(self.training.lengths(), _STEP_LIMIT_PERCENTILE)))

    def init(self, generator: torch.Generator) -> State:
        """Returns the state before the first update."""
        network = SkillsNetwork(self.spec)
        weights.initialise(network, generator=generator)
        if self.encoder.is_trained:
            for own, normalised in zip(network.encoder.buffers(), self.encoder.buffers(), strict=True):
                own.copy_(normalised)
        else:
            network.encoder.load_state_dict(self.encoder.state_dict())
        if self.training.features is not None:
            network.fit_feature_normalisation(torch.cat(list(self.training.features.values())), generator=generator)
        return TrainState.with_adam(network.to(self.device), self.config.lr, generator=generator)

    def update(self, state: State, items: npt.NDArray[np.int64]) -> tuple[State, dict[str, float]]:
        """Returns the state after one update on some segments, and its metrics."""
        config, network = self.config, state.network
        rng = np.random.default_rng(torch.randint(2**62, (2,), generator=state.generator).tolist())
        segments = [self.training.segments[item] for item in items.tolist()]
        starts = [_sample_start(each, rng, config) for each in segments]
        batch = collate(self.training, segments, starts, steps_after=config.termination_steps, device=self.device)
        features = self._shifted(network, padded_features(network, batch), rng)
        losses = skill_losses(network, features, batch)
        loss = losses.action + config.termination_weight * losses.termination
        state, metrics = fit_step(state, loss, config)
        return state, metrics | {
            "action_loss": losses.action.item(),
            "termination_loss": losses.termination.item(),
        }

    def evaluate(self, state: State) -> float:
        """Returns the training loss on validation segments."""
        losses = self.validation_losses(state.network)
        return (losses.action + self.config.termination_weight * losses.termination).item()

    @torch.no_grad()
    def validation_losses(self, network: SkillsNetwork) -> SkillsLosses:
        """Returns the losses on validation segments, each from its labelled start."""
        batch = self._validation_batch(network)
        return skill_losses(network, padded_features(network, batch), batch)

    @torch.no_grad()
    def calibrate(self, network: SkillsNetwork) -> None:
        """Fits the network's in-distribution score, to training frames as they were seen and to held-out segments."""
        known = sampled_statistics(self.training.trajectories.subset(self.training.shown))
        batch = self._validation_batch(network)
        _, terminations = _predict(network, padded_features(network, batch), batch)
        reached = terminations[batch.inside].sigmoid()  # (N,)
        network.in_distribution.fit(
            known.to(self.device), segment_statistics(self.validation).to(self.device), confidence(reached)
        )

    def _shifted(self, network: SkillsNetwork, features: Tensor, rng: np.random.Generator) -> Tensor:
        """Returns features, float32 (B, T, D), with a random shift each, as the configuration says."""
        if network.attention is None:
            return features
        shift = self.config.random_shift * torch.tensor(rng.uniform(-1, 1, len(features)), dtype=torch.float32)
        return network.attention.shift(features, shift.to(self.device))

    def _validation_batch(self, network: SkillsNetwork) -> SegmentBatch:
        """Returns the validation segments, each from its labelled start, with features."""
        dataset = self.validation
        if network.encoder.is_trained:
            dataset = replace(dataset, features=encode(network.encoder, dataset.trajectories, dataset.shown))
        starts = [each.start for each in dataset.segments]
        steps_after = self.config.termination_steps
        return collate(dataset, dataset.segments, starts, steps_after=steps_after, device=self.device)


def encode(encoder: CameraEncoders, trajectories: Trajectories, items: Sequence[int]) -> dict[int, Tensor]:
    """Returns the features of each frame of some trajectories, float32 (T, D) each, on the CPU."""
    return {item: encode_trajectory(encoder, trajectories, item).cpu() for item in items}


def padded_features(network: SkillsNetwork, batch: SegmentBatch) -> Tensor:
    """Returns the features of a batch, float32 (B, T, D), padded by zeros; frames are encoded."""
    features = batch.images if isinstance(batch.images, Tensor) else network.encoder(batch.images)  # (N, D)
    return pad_sequence(list(features.split(batch.lengths)), batch_first=True)


def skill_losses(network: SkillsNetwork, features: Tensor, batch: SegmentBatch) -> SkillsLosses:
    """Returns the losses on a batch with features (B, T, D)."""
    choices = network.spec.action.choices
    predicted, terminations = _predict(network, features, batch)
    if choices:
        error = objectives.action_cross_entropy(predicted, action_bins.encode(batch.actions, choices=choices))
    else:
        error = objectives.absolute_error(predicted, batch.actions)  # (B, T)
    continues = batch.inside & ~batch.terminates
    termination = objectives.termination_loss(terminations, batch.terminates, continues)
    return SkillsLosses(objectives.masked_mean(error, batch.inside), termination)


def _predict(network: SkillsNetwork, features: Tensor, batch: SegmentBatch) -> tuple[Tensor, Tensor]:
    """Returns actions and termination logits of a batch with features (B, T, D); see `SkillsNetwork.forward`."""
    skill = functional.one_hot(batch.skills, len(network.spec.skills)).float()  # (B, skills)
    predicted, terminations, _ = network(features, skill, batch.previous)
    return predicted, terminations


def _normalised_encoder(spec: SkillsSpec, demonstrations: Trajectories, *, seed: int) -> CameraEncoders:
    encoder = CameraEncoders(ENCODERS[spec.encoder], spec.cameras, features=spec.features)
    sampled = demonstrations.sample_frames(_NORMALISATION_FRAMES)
    frames = {camera: torch.from_numpy(each) for camera, each in sampled.items()}
    encoder.fit_normalisation(frames, generator=torch.Generator().manual_seed(seed))
    return encoder


def _sample_start(segment: SkillSegment, rng: np.random.Generator, config: SkillsConfig) -> int:
    """Returns a start near the labelled one, which is inexact, or anywhere in the segment."""
    latest = max(segment.start, segment.stop - _LEAST_STEPS_LEFT)
    if rng.random() < config.random_start_fraction:
        return int(rng.integers(segment.start, latest, endpoint=True))
    jitter = int(rng.integers(-config.start_jitter, config.start_jitter, endpoint=True))
    return min(max(0, segment.start + jitter), latest)
