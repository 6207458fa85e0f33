"""Behavioural cloning of skills from frames, executed actions and predicted skill labels."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn import functional

from freerein.errors import InvalidInput
from freerein.learning import weights
from freerein.learning.config import bounded
from freerein.learning.fit_config import FitConfig
from freerein.learning.optimiser import fit_step
from freerein.learning.train_state import TrainState
from freerein.learning.trajectories import TrajectoryArrays
from freerein_imitation import objectives
from freerein_imitation.model import action_bins
from freerein_imitation.model.colour_codebook import ColourCodebook, shift_horizontally
from freerein_imitation.model.policy import PolicyNetworkSpec
from freerein_imitation.model.skills import SkillsNetwork, SkillsSpec
from freerein_imitation.training.skill_segments import (
    SegmentBatch,
    SegmentDataset,
    SkillSegment,
    collate,
    find_segments,
    split_segments,
)
from freerein_imitation.training.trajectories import TrajectoryDataset

State = TrainState[SkillsNetwork]

TERMINATION_THRESHOLD = 0.5
"""Probability from which on a skill has terminated; the loss gives both classes equal weight."""

_CODEBOOK_FRAMES = 500
_ENCODE_BATCH = 256
_LEAST_STEPS_LEFT = 5
_STEP_LIMIT_FACTOR = 1.5
_STEP_LIMIT_PERCENTILE = 95


@dataclass(frozen=True)
class SkillsConfig(FitConfig):
    """Configuration of a fit of skills.

    Attributes:
        policy: Kind of policy.
        camera: Camera whose frames to train on; may be empty where the dataset has one.
        min_segment_steps: Shorter segments are taken for label errors, as in section 2.4.
        start_jitter: Timesteps by which a segment's start is moved at random, either way.
        random_start_fraction: Fraction of segments started at a random timestep, so that time alone does not determine
            the action.
        termination_steps: Timesteps after a segment's last in which the termination target stays 1.
        random_shift: Largest random horizontal shift of a frame's contents; 1 is half of the frame.
        termination_weight: Weight of the termination loss relative to the action loss.
        batch_size: Segments per update.
        codebook_size: Colours in the codebook.
        hidden_size: Units of the hidden layers.
        recurrent_size: Units of the LSTM.
        validation_fraction: Fraction of trajectories held out to choose the best weights.
    """

    policy: Literal["skills"] = "skills"
    camera: str = ""
    min_segment_steps: int = bounded(5, least=1, most=1000)
    start_jitter: int = bounded(3, least=0, most=1000)
    random_start_fraction: float = bounded(0.5, least=0.0, most=1.0)
    termination_steps: int = bounded(3, least=0, most=1000)
    random_shift: float = bounded(0.3, least=0.0, most=1.0)
    termination_weight: float = bounded(0.1, least=0.0, most=100.0)
    steps: int = bounded(2500, least=1, most=10_000_000)
    batch_size: int = bounded(12, least=1, most=1024)
    codebook_size: int = bounded(32, least=2, most=256)
    hidden_size: int = bounded(128, least=8, most=1024)
    recurrent_size: int = bounded(64, least=8, most=1024)
    validation_fraction: float = bounded(0.1, least=0.01, most=0.5)
    evaluate_every: int = bounded(200, least=1, most=1_000_000)
    checkpoint_every: int = bounded(500, least=1, most=1_000_000)
    log_every: int = bounded(20, least=1, most=1_000_000)

    def network_spec(self, sizes: PolicyNetworkSpec, skills: tuple[str, ...]) -> SkillsSpec:
        """Returns the spec of the network for a dataset's frame and action sizes, and some skills."""
        return SkillsSpec(
            **asdict(sizes),
            skills=skills,
            codebook_size=self.codebook_size,
            hidden_size=self.hidden_size,
            recurrent_size=self.recurrent_size,
        )


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
        codebook: Fitted colour codebook.
        training: Training segments.
        validation: Validation segments.
        fingerprint: Fingerprint of the dataset and its labels.
        device: Device to train on.
    """

    config: SkillsConfig
    spec: SkillsSpec
    codebook: ColourCodebook
    training: SegmentDataset
    validation: SegmentDataset
    fingerprint: str
    device: torch.device

    @classmethod
    def prepare(
        cls,
        config: SkillsConfig,
        sizes: PolicyNetworkSpec,
        demonstrations: TrajectoryDataset,
        labels: Sequence[npt.NDArray[np.int64]],
        *,
        skills: tuple[str, ...],
        fingerprint: str,
        device: torch.device,
    ) -> "SkillsLearner":
        """Returns the learner for labelled demonstrations; encodes every frame once.

        Args:
            config: Configuration.
            sizes: Frame and action sizes.
            demonstrations: Frames and executed actions.
            labels: By trajectory, the predicted skill at each timestep, int64 (T,).
            skills: Names that labels index. Those without a training segment are left out.
            fingerprint: Fingerprint of the dataset and its labels.
            device: Device to train on.

        Raises:
            InvalidInput: Segments are of fewer than 2 trajectories, or validation and training share no skill.
        """
        spec = config.network_spec(sizes, skills)
        codebook = ColourCodebook(height=spec.height, width=spec.width, channels=spec.channels, size=spec.codebook_size)
        frames = torch.from_numpy(demonstrations.sample_frames(_CODEBOOK_FRAMES))
        codebook.fit(frames, generator=torch.Generator().manual_seed(config.seed))
        moments = encode_trajectories(codebook, demonstrations.frames)
        segments = find_segments(labels, min_steps=config.min_segment_steps)
        dataset = SegmentDataset(segments, moments, demonstrations.actions)
        training, validation = split_segments(dataset, fraction=config.validation_fraction, seed=config.seed)
        trained = sorted({each.skill for each in training.segments})
        training, validation = training.only(trained), validation.only(trained)
        if not len(validation):
            raise InvalidInput(
                "The validation trajectories must show a skill that the training ones show; they show none.",
                field="dataset",
                hint="Record more demonstrations, and label them.",
            )
        spec = replace(spec, skills=tuple(skills[skill] for skill in trained))
        return cls(config, spec, codebook, training, validation, fingerprint, device)

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
        network.codebook.load_state_dict(self.codebook.state_dict())
        network.fit_normalisation(torch.cat(list(self.training.moments)), generator=generator)
        network = network.to(self.device)
        return TrainState(network, torch.optim.Adam(network.parameters(), self.config.lr, fused=True), generator)

    def update(self, state: State, items: npt.NDArray[np.int64]) -> tuple[State, dict[str, float]]:
        """Returns the state after one update on some segments, and its metrics."""
        config = self.config
        rng = np.random.default_rng(torch.randint(2**62, (2,), generator=state.generator).tolist())
        segments = [self.training.segments[item] for item in items.tolist()]
        starts = [_sample_start(each, rng, config) for each in segments]
        batch = collate(self.training, segments, starts, steps_after=config.termination_steps, device=self.device)
        shift = config.random_shift * torch.tensor(rng.uniform(-1, 1, len(items)), dtype=torch.float32)
        moments = shift_horizontally(batch.moments, shift.to(batch.moments.device))
        losses = skill_losses(state.network, replace(batch, moments=moments))
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
        segments, steps_after = self.validation.segments, self.config.termination_steps
        starts = [each.start for each in segments]
        batch = collate(self.validation, segments, starts, steps_after=steps_after, device=self.device)
        return skill_losses(network, batch)


@torch.no_grad()
def encode_trajectories(codebook: ColourCodebook, frames: TrajectoryArrays[np.uint8]) -> list[Tensor]:
    """Returns the colour moments of each trajectory's frames, float32 (T, colours, MOMENTS) each, on the CPU."""
    return [
        torch.cat(
            [
                codebook(torch.tensor(frames[item][start : start + _ENCODE_BATCH]))
                for start in range(0, len(frames[item]), _ENCODE_BATCH)
            ]
        )
        for item in range(len(frames))
    ]


def skill_losses(network: SkillsNetwork, batch: SegmentBatch) -> SkillsLosses:
    """Returns the losses on a batch."""
    spec = network.spec
    skill = functional.one_hot(batch.skills, len(spec.skills)).float()  # (B, skills)
    predicted, terminations, _ = network(batch.moments, skill, batch.previous)
    if spec.action_choices:
        target = action_bins.encode(batch.actions, choices=spec.action_choices)
        error = objectives.action_cross_entropy(predicted, target)
    else:
        error = objectives.absolute_error(predicted, batch.actions)  # (B, T)
    continues = batch.inside & ~batch.terminates
    termination = objectives.termination_loss(terminations, batch.terminates, continues)
    return SkillsLosses(objectives.masked_mean(error, batch.inside), termination)


def _sample_start(segment: SkillSegment, rng: np.random.Generator, config: SkillsConfig) -> int:
    """Returns a start near the labelled one, which is inexact, or anywhere in the segment."""
    latest = max(segment.start, segment.stop - _LEAST_STEPS_LEFT)
    if rng.random() < config.random_start_fraction:
        return int(rng.integers(segment.start, latest, endpoint=True))
    jitter = int(rng.integers(-config.start_jitter, config.start_jitter, endpoint=True))
    return min(max(0, segment.start + jitter), latest)
