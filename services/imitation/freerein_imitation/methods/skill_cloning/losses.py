"""Behavioural cloning of skills from labelled demonstrations: a loss for the next actions, and one for a skill's end.

Timesteps without a label, and segments that are too short, are left out; they are still seen as earlier frames.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn import functional

from freerein.learning import weights
from freerein.learning.augmentation import shift
from freerein.learning.image_statistics import image_statistics
from freerein.learning.learner import Items, Learner, Losses
from freerein.learning.train_state import TrainState
from freerein.learning.trajectories import Trajectories
from freerein_imitation.methods.shared.frame_features import sampled_statistics
from freerein_imitation.methods.shared.losses import action_cross_entropy, masked_mean, termination_loss
from freerein_imitation.methods.shared.skill_segments import (
    Ints,
    SkillSegment,
    find_segments,
    generous_limit,
    keep_tagged,
    split_segments,
)
from freerein_imitation.methods.skill_cloning.config import SkillCloningConfig
from freerein_imitation.methods.skill_cloning.memory import averaged_end
from freerein_imitation.methods.skill_cloning.network import SkillCloningNetwork, SkillCloningSpec
from freerein_imitation.methods.skill_cloning.spans import NONE, RobotStates, SkillTimes, SpanBatch, Spans

State = TrainState[SkillCloningNetwork]

_NORMALISATION_FRAMES = 800
_EVALUATED_SPANS = 120
_BUDGET_PERCENTILE = 75
_NO_MEMORY = 0.1
"""Share of spans without earlier frames, as at the start of an episode."""

_THRESHOLDS = np.linspace(0.5, 0.98, 25)
_EARLY_COST = 3.0
"""What a timestep too early costs relative to one too late, where the threshold of the termination head is chosen: a
skill that goes on for longer rests at its end, and one that is broken off is not completed."""


@dataclass(frozen=True, eq=False)
class SkillCloningLearner(Learner[SkillCloningNetwork]):
    """The learner of skills from labelled demonstrations. Its items are timesteps of training segments.

    Attributes:
        spec: Spec of the network; its skills are those of the training segments.
        spans: Reads spans of the demonstrations.
        segments: Training segments.
        held_out: Segments of held-out trajectories.
        items: Trajectory and timestep of each item, int64 (N, 2).
    """

    config: SkillCloningConfig
    spec: SkillCloningSpec
    spans: Spans
    segments: Sequence[SkillSegment]
    held_out: Sequence[SkillSegment]
    items: Ints
    fingerprint: str
    device: torch.device

    @classmethod
    def prepare(
        cls,
        config: SkillCloningConfig,
        spec: SkillCloningSpec,
        demonstrations: Trajectories,
        labels: Sequence[Ints],
        *,
        fingerprint: str,
        device: torch.device,
        robot_states: RobotStates = (),
    ) -> "SkillCloningLearner":
        """Returns the learner of labelled demonstrations.

        `spec` has all skills that the labels may name. Labels are the predicted skill at each timestep, int64 (T,) by
        trajectory; -1 for none. `robot_states` are as of `Spans`; empty where the spec has no state.

        Raises:
            InvalidInput: Segments are of fewer than 2 trajectories, or validation and training share no skill.
        """
        found = find_segments(labels, min_steps=config.min_segment_steps)
        kept = keep_tagged(found, demonstrations.skills, skills=spec.skills)
        split = split_segments(kept, fraction=config.validation_fraction, seed=config.seed)
        spans = Spans(
            demonstrations,
            _times(split.training + split.validation, demonstrations.lengths(), steps_after=config.termination_steps),
            spec.action.no_action(),
            earlier=config.memory,
            past_actions=config.past_actions,
            chunk=config.chunk,
            robot_states=robot_states,
        )
        items = [(each.trajectory, step) for each in split.training for step in range(each.start, each.stop)]
        return cls(
            config,
            replace(spec, skills=tuple(spec.skills[skill] for skill in split.skills)),
            spans,
            split.training,
            split.validation,
            np.array(items, np.int64),
            fingerprint,
            device,
        )

    @property
    def size(self) -> int:
        """Timesteps of training segments."""
        return len(self.items)

    def step_limits(self) -> tuple[int, ...]:
        """Returns, by skill, the control steps after which it is over, from the lengths of training segments.

        They are a budget, the 75th percentile of segment lengths, or a generous limit beside the head.
        """
        by_skill = [[each for each in self.segments if each.skill == skill] for skill in range(len(self.spec.skills))]
        if self.config.ends == "head":
            return tuple(generous_limit(each) for each in by_skill)
        lengths = [[each.stop - each.start for each in segments] for segments in by_skill]
        return tuple(math.ceil(float(np.percentile(each, _BUDGET_PERCENTILE))) for each in lengths)

    def init(self, generator: torch.Generator) -> State:
        """Returns the state before the first update."""
        network = SkillCloningNetwork(self.spec)
        weights.initialise(network, generator=generator)
        shown, states = self._shown(), self.spans.robot_states
        frames = shown.sample_frames(_NORMALISATION_FRAMES)
        executed = np.concatenate([shown.actions[item] for item in range(len(shown))])
        network.fit_normalisation(frames, torch.from_numpy(executed), generator=generator)
        if states:
            network.fit_robot_state(torch.from_numpy(np.concatenate([states[item] for item in self._shown_items()])))
        return TrainState.with_adam(network.to(self.device), self.config.lr, generator=generator)

    def loss(self, state: State, items: Items) -> Losses:
        """Returns the losses of spans around some timesteps."""
        rng = state.rng()
        trajectories, steps = self.items[items].T
        starts = np.maximum(steps - rng.integers(self.config.span, size=len(items)), 0)
        batch = self._augmented(self.spans.read(trajectories, starts, self.config.span), rng)
        return self._losses(state.network, batch)

    def evaluate(self, state: State) -> float:
        """Returns the loss on spans of held-out segments."""
        return self.validation_losses(state.network)["train_loss"].item()

    @torch.no_grad()
    def validation_losses(self, network: SkillCloningNetwork) -> Losses:
        """Returns the losses on spans of held-out segments."""
        span = self.config.span
        places = [(each.trajectory, at) for each in self.held_out for at in range(each.start, each.stop, span)]
        chosen = np.array(places[:: 1 + len(places) // _EVALUATED_SPANS], np.int64)
        return self._losses(network, self.spans.read(chosen[:, 0], chosen[:, 1], span))

    @torch.no_grad()
    def calibrate(self, network: SkillCloningNetwork) -> None:
        """Fits the network's in-distribution score, to training frames and to held-out ones."""
        known, ends = sampled_statistics(self._shown()), self._end_probabilities(network)
        statistics = []
        for segment in self.held_out:
            frames = {
                camera: torch.tensor(arrays[segment.trajectory][segment.start : segment.stop])
                for camera, arrays in self.spans.demonstrations.frames.items()
            }
            statistics.append(image_statistics(frames))
        reached = torch.cat([each[: seg.stop - seg.start] for each, seg in zip(ends, self.held_out, strict=True)])
        felt = self._calibrate_robot_state(network) if self.spans.robot_states else None
        network.in_distribution.fit(
            known.to(self.device),
            torch.cat(statistics).to(self.device),
            network.confidence(reached, felt),
            trajectories=self._held_out_trajectories(),
        )

    def _held_out_trajectories(self) -> int:
        return len({each.trajectory for each in self.held_out})

    def _calibrate_robot_state(self, network: SkillCloningNetwork) -> Tensor:
        """Fits the score of the robot's state; returns the states of held-out segments, float32 (N, S)."""
        states = self.spans.robot_states
        known = self._tensor(np.concatenate([states[item] for item in self._shown_items()]))
        held_out = self._tensor(
            np.concatenate([states[each.trajectory][each.start : each.stop] for each in self.held_out])
        )
        network.robot_state_in_distribution.fit(
            network.standardised(known),
            network.standardised(held_out),
            torch.ones(len(held_out), device=self.device),
            trajectories=self._held_out_trajectories(),
        )
        return held_out

    @torch.no_grad()
    def termination_threshold(self, network: SkillCloningNetwork) -> float:
        """Returns the probability at which held-out skills end nearest to where they were demonstrated to end."""
        ends = [_averaged(each) for each in self._end_probabilities(network)]
        lasts = np.array([each.stop - 1 - each.start for each in self.held_out])

        def cost(threshold: float) -> float:
            first = np.array([np.argmax(each >= threshold) if each.max() >= threshold else len(each) for each in ends])
            late = first - lasts
            return float(np.where(late < 0, -_EARLY_COST * late, late).mean())

        return float(min(_THRESHOLDS, key=cost))

    def _end_probabilities(self, network: SkillCloningNetwork) -> list[Tensor]:
        """Returns, of each held-out segment and the steps after it, the probability that its skill has ended."""
        after = self.config.termination_steps
        found = []
        for segment in self.held_out:
            length = len(self.spans.demonstrations.actions[segment.trajectory])
            steps = min(segment.stop + after, length) - segment.start
            batch = self.spans.read(np.array([segment.trajectory]), np.array([segment.start]), steps)
            _, logits = self._predict(network, batch, np.arange(steps), np.full(steps, segment.skill))
            found.append(logits.sigmoid())
        return found

    def _losses(self, network: SkillCloningNetwork, batch: SpanBatch) -> Losses:
        skill, ended = batch.skill.ravel(), batch.ended.ravel()  # (B * L,)
        inside, after = np.flatnonzero(skill != NONE), np.flatnonzero(ended != NONE)
        steps = np.concatenate([inside, after])
        chunk, logits = self._predict(network, batch, steps, np.concatenate([skill[inside], ended[after]]))
        target = network.encode_actions(self._tensor(_flat(batch.actions)[inside]))  # (N, K, O)
        predicted, is_own = chunk[: len(inside)], self._tensor(_flat(batch.is_own)[inside])
        if self.spec.action.choices:
            error = action_cross_entropy(predicted[..., None, :], target[..., None, :])
        else:
            error = functional.smooth_l1_loss(predicted, target, reduction="none").mean(dim=-1)  # (N, K)
        has_ended = np.concatenate([batch.terminates.ravel()[inside], np.ones(len(after), bool)])
        terminates = self._tensor(has_ended)
        action = masked_mean(error, is_own)
        termination = termination_loss(logits, terminates, ~terminates)
        total = action + self.config.termination_weight * termination
        return {"train_loss": total, "action_loss": action, "termination_loss": termination}

    def _predict(
        self, network: SkillCloningNetwork, batch: SpanBatch, steps: Ints, skill: Ints
    ) -> tuple[Tensor, Tensor]:
        """Returns chunks, float32 (N, K, O), and termination logits, (N,), at some timesteps of spans.

        Args:
            network: The network.
            batch: The spans.
            steps: Timesteps, span after span, int64 (N,).
            skill: Skill at each, int64 (N,).
        """
        length, earlier = batch.skill.shape[1], self.config.memory
        features = self._encode(network, batch)  # (B, n + L, D)
        span, step = self._tensor(steps // length), self._tensor(steps % length)
        back = torch.arange(earlier, -1, -1, device=self.device)
        window = features[span[:, None], step[:, None] + back]  # (N, 1 + n, D), the newest first
        return network(  # type: ignore[no-any-return]
            window[:, 0],
            functional.one_hot(self._tensor(skill), len(self.spec.skills)).float(),
            window[:, 1:],
            self._tensor(_flat(batch.is_known)[steps]),
            network.encode_actions(self._tensor(_flat(batch.executed)[steps])),
        )

    def _encode(self, network: SkillCloningNetwork, batch: SpanBatch) -> Tensor:
        """Returns the features of spans and of the timesteps before them, float32 (B, n + L, D).

        They are encoded in parts, none of which has more frames than an update.
        """
        spans, length = batch.skill.shape
        count = spans * (self.config.memory + length)
        at_once = self.config.batch_size * (self.config.memory + self.config.span)
        features = torch.cat(
            [self._encode_part(network, batch, slice(at, at + at_once)) for at in range(0, count, at_once)]
        )
        return features.view(spans, -1, features.shape[1])

    def _encode_part(self, network: SkillCloningNetwork, batch: SpanBatch, part: slice) -> Tensor:
        frames = {name: each[part].to(self.device) for name, each in batch.frames.items()}
        states = None if batch.robot_states is None else self._tensor(batch.robot_states[part])
        return network.encode(frames, states)

    def _augmented(self, batch: SpanBatch, rng: np.random.Generator) -> SpanBatch:
        """Returns a batch with shifted frames, where some spans have no earlier frames, and some no past actions."""
        spans, length = batch.skill.shape
        most = min(self.config.shift, *(min(each.height, each.width) - 1 for each in self.spec.cameras))
        offsets = -torch.from_numpy(rng.integers(-most, most, (spans, 2), endpoint=True))
        by_frame = offsets.repeat_interleave(self.config.memory + length, dim=0)  # (B * (n + L), 2)
        frames = {name: shift(each, by_frame) for name, each in batch.frames.items()}
        untold = rng.random((spans, length, 1, 1)) < self.config.past_action_dropout
        executed = np.where(untold, self.spans.no_action, batch.executed)
        is_known = batch.is_known & (rng.random((spans, 1, 1)) >= _NO_MEMORY)
        return replace(batch, frames=frames, executed=executed, is_known=is_known)

    def _shown(self) -> Trajectories:
        """Returns the trajectories of the training segments."""
        return self.spans.demonstrations.subset(self._shown_items())

    def _shown_items(self) -> list[int]:
        return sorted({each.trajectory for each in self.segments})

    def _tensor(self, array: npt.NDArray[Any]) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(array)).to(self.device)


def _averaged(ended: Tensor) -> npt.NDArray[np.float32]:
    """Returns the probabilities that a skill has ended, of a segment's frames, as its policy averages them: (T,)."""
    found, average = [], torch.zeros(())
    for each in ended.cpu():
        average = averaged_end(average, each)
        found.append(average.item())
    return np.array(found, np.float32)


def _flat(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Returns values of spans (B, L, ...) span after span, (B * L, ...)."""
    return values.reshape(values.shape[0] * values.shape[1], *values.shape[2:])


def _times(segments: Sequence[SkillSegment], lengths: Ints, *, steps_after: int) -> list[SkillTimes]:
    by_trajectory: list[list[SkillSegment]] = [[] for _ in lengths]
    for each in segments:
        by_trajectory[each.trajectory].append(each)
    return [
        SkillTimes.of(own, int(length), steps_after=steps_after)
        for own, length in zip(by_trajectory, lengths, strict=True)
    ]
