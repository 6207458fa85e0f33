"""Behavioural cloning of skills from frames, executed actions and predicted skill labels.

A fit has three parts, each of which learns from what the one before has found:

1. the gripper: a keypoint from whose motion and surroundings the actions executed between two frames are estimated;
2. heat maps: the gripper's keypoints at a skill's grasp and release are those where its object was and was put;
3. the policy: the next waypoint, and termination, given these keypoints.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn import functional

from freerein.learning import weights
from freerein.learning.augmentation import delayed
from freerein.learning.image_statistics import image_statistics
from freerein.learning.learner import Items, Learner, Losses, Stage
from freerein.learning.train_state import TrainState
from freerein.learning.trajectories import Trajectories
from freerein_imitation.methods.shared.frame_features import sampled_statistics
from freerein_imitation.methods.shared.losses import masked_mean, termination_loss
from freerein_imitation.methods.shared.skill_segments import (
    Ints,
    SkillSegment,
    find_segments,
    match_tags,
    split_segments,
)
from freerein_imitation.methods.shared.views import Views
from freerein_imitation.methods.skills.config import SkillsConfig
from freerein_imitation.methods.skills.network import SkillsNetwork, SkillsSpec
from freerein_imitation.methods.skills.skill_steps import SkillSteps, end_at_waypoints, steps_of
from freerein_imitation.methods.skills.waypoints import Waypoints
from freerein_imitation.model.torch_policy import confidence

State = TrainState[SkillsNetwork]

TERMINATION_THRESHOLD = 0.97
"""Probability from which on a skill has terminated. The loss gives both classes equal weight, but to end late costs a
few timesteps, and to end early the object."""

_GRIPPER_SHARE, _MAPS_SHARE = 0.07, 0.04
_GRIPPER_SHARE_AUGMENTED, _MAPS_SHARE_AUGMENTED = 0.09, 0.09
"""Shares of a fit's steps for the gripper, and for the heat maps, which see more where frames are augmented."""

_NORMALISATION_FRAMES = 500
_EVALUATED_STEPS = 1000
_FRAMES_AT_ONCE = 256
_ODOMETRY_BETA = 0.2  # actions; larger errors count linearly
_PLACE_WEIGHT = 0.5
_MAP_WIDTH = 0.8  # cells
_GRIPPER_NOISE, _OBJECT_NOISE, _PLACE_NOISE = 0.004, 0.01, 0.015
"""Standard deviations of the noise of keypoints that the policy is trained with: errors of frames never seen are larger
than those of training frames."""

_NO_PREVIOUS = 0.2
"""Share of timesteps at which the policy is not conditioned on the previous action, so as not merely to repeat it."""

_AUGMENTED = 0.5
"""Share of training frames that are augmented, once augmentation begins."""


@dataclass(frozen=True, eq=False)
class SkillsLearner(Learner[SkillsNetwork]):
    """The learner of skills from labelled demonstrations. Its items are training timesteps.

    Attributes:
        spec: Spec of the network; its skills are those of the training segments.
        segments: Training segments.
        training: Their timesteps.
        validation: Timesteps of held-out trajectories' segments.
    """

    config: SkillsConfig
    spec: SkillsSpec
    demonstrations: Trajectories
    segments: Sequence[SkillSegment]
    training: SkillSteps
    validation: SkillSteps
    fingerprint: str
    device: torch.device
    _found: dict[str, Any] = field(default_factory=dict)
    """Keypoints that the gripper's and the maps' stages find in the training frames; computed again after a resume."""

    @classmethod
    def prepare(
        cls,
        config: SkillsConfig,
        spec: SkillsSpec,
        demonstrations: Trajectories,
        labels: Sequence[Ints],
        *,
        fingerprint: str,
        device: torch.device,
    ) -> "SkillsLearner":
        """Returns the learner of labelled demonstrations.

        `spec` has all skills that the labels may name. Labels are the predicted skill at each timestep, int64 (T,) by
        trajectory; -1 for none.

        Raises:
            InvalidInput: Segments are of fewer than 2 trajectories, or validation and training share no skill.
        """
        executed = [np.asarray(demonstrations.actions[item], np.float32) for item in range(len(demonstrations))]
        waypoints = [Waypoints.of(each) for each in executed]
        found = find_segments(labels, min_steps=config.min_segment_steps)
        tags = demonstrations.skills or [()] * len(demonstrations)
        known = [[number for number, skill in enumerate(spec.skills) if skill in each] for each in tags]
        tagged = match_tags(found, known)
        segments = end_at_waypoints(tagged, demonstrations, waypoints, is_gripper=spec.is_gripper)
        split = split_segments(segments, fraction=config.validation_fraction, seed=config.seed)
        steps = [
            steps_of(each, demonstrations, waypoints, is_gripper=spec.is_gripper, steps_after=config.termination_steps)
            for each in (split.training, split.validation)
        ]
        every = 1 + len(steps[1]) // _EVALUATED_STEPS
        return cls(
            config,
            replace(spec, skills=tuple(spec.skills[skill] for skill in split.skills)),
            demonstrations,
            split.training,
            steps[0],
            steps[1][::every],
            fingerprint,
            device,
        )

    @property
    def size(self) -> int:
        """Training timesteps."""
        return len(self.training)

    def init(self, generator: torch.Generator) -> State:
        """Returns the state before the first update."""
        network = SkillsNetwork(self.spec)
        weights.initialise(network, generator=generator)
        shown = self.demonstrations.subset(self._shown)
        frames = shown.sample_frames(_NORMALISATION_FRAMES)
        executed = np.concatenate([shown.actions[item] for item in range(len(shown))])
        network.fit_normalisation(frames, torch.from_numpy(np.asarray(executed, np.float32)))
        return TrainState.with_adam(network.to(self.device), self.config.lr, generator=generator)

    def stages(self) -> tuple[Stage[SkillsNetwork], ...]:
        """Returns the three parts of a fit."""
        gripper, maps = self._gripper_and_maps()
        return (
            self._stage("hand", gripper, self._gripper_loss),
            self._stage("maps", maps - gripper, self._maps_loss),
            self._stage("policy", self.config.steps - maps, self._policy_loss),
        )

    def _stage(
        self, name: str, steps: int, loss: Callable[[SkillsNetwork, Items, np.random.Generator, Views], Tensor]
    ) -> Stage[SkillsNetwork]:
        """Returns a stage; frames are augmented once the gripper has been found in them as they are."""

        def losses(state: State, items: Items) -> Losses:
            rng, (gripper, _) = state.rng(), self._gripper_and_maps()
            strength = delayed(self.config.augmentation, step=state.step, steps=gripper)
            views = Views(strength, _AUGMENTED, state.generator)
            return {"train_loss": loss(state.network, items, rng, views)}

        return Stage(name, steps, losses)

    def _gripper_and_maps(self) -> tuple[int, int]:
        """Returns the steps after which the gripper is learned, and after which the maps are, too."""
        is_augmented = self.config.augmentation > 0
        shares = (_GRIPPER_SHARE_AUGMENTED, _MAPS_SHARE_AUGMENTED) if is_augmented else (_GRIPPER_SHARE, _MAPS_SHARE)
        gripper, maps = np.round(np.cumsum(shares) * self.config.steps).astype(int).tolist()
        return gripper, maps

    def evaluate(self, state: State) -> float:
        """Returns the loss of the policy on validation timesteps, on frames as they are and augmented ones."""
        strengths = {0.0, self.config.augmentation}
        losses = [self.validation_losses(state.network, strength=each)["train_loss"].item() for each in strengths]
        return sum(losses) / len(losses)

    @torch.no_grad()
    def validation_losses(self, network: SkillsNetwork, *, strength: float = 0.0) -> Losses:
        """Returns the losses on validation timesteps, with keypoints as the network finds them in augmented frames."""
        views = Views(strength, 1.0, torch.Generator().manual_seed(self.config.seed))
        parts = [self._predict(network, each, views) for each in self._validation_parts()]
        displacement, termination = (torch.cat(each) for each in zip(*parts, strict=True))
        return self._losses(displacement, termination, self.validation)

    @torch.no_grad()
    def calibrate(self, network: SkillsNetwork) -> None:
        """Fits the network's in-distribution score, to training frames as they were seen and to held-out ones."""
        shown, config = self.demonstrations.subset(self._shown), self.config
        known = sampled_statistics(shown, augmentation=config.augmentation, seed=config.seed)
        parts, terminations, as_recorded = [], [], Views(0.0, 0.0, torch.Generator())
        for steps in self._validation_parts():
            inside = steps[steps.is_inside]
            parts.append(image_statistics(self._frames(inside.trajectory, inside.timestep)))
            terminations.append(self._predict(network, inside, as_recorded)[1])
        reached = torch.cat(terminations).sigmoid()
        trajectories = len(np.unique(self.validation.trajectory))
        network.in_distribution.fit(
            known.to(self.device), torch.cat(parts), confidence(reached), trajectories=trajectories
        )

    @property
    def _shown(self) -> list[int]:
        """Trajectories of the training segments, ascending."""
        return sorted({each.trajectory for each in self.segments})

    def _gripper_loss(self, network: SkillsNetwork, items: Items, rng: np.random.Generator, views: Views) -> Tensor:
        """Returns the error of the actions between pairs of timesteps, as estimated from the gripper's motion."""
        first = self.training[items]
        lengths = np.array([len(self.demonstrations.actions[item]) for item in first.trajectory])
        ends = rng.integers(0, lengths)
        pairs = list(zip(first.trajectory.tolist(), first.timestep.tolist(), ends.tolist(), strict=True))
        executed = np.stack([self._executed(item, stop) - self._executed(item, start) for item, start, stop in pairs])
        before = np.stack([self._previous(item, stop) - self._previous(item, start) for item, start, stop in pairs])
        pixels, shift = self._seen(network, np.tile(first.trajectory, 2), np.append(first.timestep, ends), views)
        grippers = network.hand(pixels)
        openings = network.hand.opening(network.hand.crop(pixels, grippers.detach()))
        moved, opened = (each[len(items) :] - each[: len(items)] for each in (grippers - shift, openings))
        estimated = network.hand.executed(moved, opened, self._tensor(before))
        return functional.smooth_l1_loss(estimated, self._tensor(executed), beta=_ODOMETRY_BETA)

    def _maps_loss(self, network: SkillsNetwork, items: Items, _: np.random.Generator, views: Views) -> Tensor:
        """Returns the cross-entropies of both heat maps; that of goal positions is of timesteps before the grasp."""
        steps, cells, grippers = self.training[items], network.maps.cells, self._grippers(network)
        pixels, shift = self._seen(network, steps.trajectory, steps.timestep, views)
        maps = network.maps(pixels, self._skills(steps))
        target, place = (
            heat_map_cross_entropy(
                logits, cells.centres, self._at(grippers, steps.trajectory, at) + shift, width=_MAP_WIDTH * cells.pitch
            )
            for logits, at in zip(maps, (steps.object_at, steps.place_at), strict=True)
        )
        is_before_grasp = self._tensor(steps.timestep < steps.object_at)
        return target.mean() + _PLACE_WEIGHT * masked_mean(place, is_before_grasp)

    def _policy_loss(self, network: SkillsNetwork, items: Items, rng: np.random.Generator, views: Views) -> Tensor:
        """Returns the losses of action and termination, with noisy keypoints."""
        steps, grippers, targets = self.training[items], self._grippers(network), self._targets(network)
        pixels, shift = self._seen(network, steps.trajectory, steps.timestep, views)
        gripper, target, place = (
            each + shift + noise * self._tensor(rng.standard_normal(each.shape).astype(np.float32))
            for each, noise in (
                (self._at(grippers, steps.trajectory, steps.timestep), _GRIPPER_NOISE),
                (targets[torch.from_numpy(items).to(self.device)], _OBJECT_NOISE),
                (self._at(grippers, steps.trajectory, steps.place_at), _PLACE_NOISE),
            )
        )
        previous = self._tensor(steps.previous * (rng.random((len(items), 1)) >= _NO_PREVIOUS).astype(np.float32))
        displacement, termination = network(pixels, gripper, target, place, previous)
        return self._losses(displacement, termination, steps)["train_loss"]

    def _losses(self, displacement: Tensor, termination: Tensor, steps: SkillSteps) -> Losses:
        inside, terminates = self._tensor(steps.is_inside), self._tensor(steps.terminates)
        error = relative_error(displacement, self._tensor(steps.displacement))  # (N,)
        action, ended = (
            masked_mean(error, inside),
            termination_loss(termination, terminates, ~terminates),
        )
        total = action + self.config.termination_weight * ended
        return {"train_loss": total, "action_loss": action, "termination_loss": ended}

    def _predict(self, network: SkillsNetwork, steps: SkillSteps, views: Views) -> tuple[Tensor, Tensor]:
        """Returns displacements and termination logits; the position of the release is the demonstration's."""
        pixels, shift = self._seen(network, steps.trajectory, steps.timestep, views)
        targets, _ = network.maps(pixels, self._skills(steps))
        place = network.hand(self._pixels(network, steps.trajectory, steps.place_at)) + shift
        displacement, termination = network(
            pixels, network.hand(pixels), network.maps.cells.mode(targets), place, self._tensor(steps.previous)
        )
        return displacement, termination

    def _validation_parts(self) -> list[SkillSteps]:
        return [self.validation[part] for part in _parts(len(self.validation))]

    @torch.no_grad()
    def _grippers(self, network: SkillsNetwork) -> list[Tensor]:
        """Returns the gripper's keypoints in all training frames, by trajectory: float32 (T, 2)."""

        def found(item: int, at: Ints) -> Tensor:
            grippers: Tensor = network.hand(self._pixels(network, np.full(len(at), item), at))
            return grippers

        if "grippers" not in self._found:
            self._found["grippers"] = [
                torch.cat([found(item, np.arange(length)[part]) for part in _parts(length)])
                for item, length in enumerate(self.demonstrations.lengths().tolist())
            ]
        grippers: list[Tensor] = self._found["grippers"]
        return grippers

    @torch.no_grad()
    def _targets(self, network: SkillsNetwork) -> Tensor:
        """Returns the object's keypoints at all training timesteps, float32 (N, 2)."""

        def found(steps: SkillSteps) -> Tensor:
            pixels = self._pixels(network, steps.trajectory, steps.timestep)
            return network.maps.cells.mode(network.maps(pixels, self._skills(steps))[0])

        if "targets" not in self._found:
            self._found["targets"] = torch.cat([found(self.training[part]) for part in _parts(len(self.training))])
        targets: Tensor = self._found["targets"]
        return targets

    def _at(self, grippers: Sequence[Tensor], trajectory: Ints, timestep: Ints) -> Tensor:
        return torch.stack(
            [grippers[item][at] for item, at in zip(trajectory.tolist(), timestep.tolist(), strict=True)]
        )

    def _executed(self, item: int, timestep: int) -> npt.NDArray[np.float32]:
        """Returns the sum of the actions before a timestep, float32 (A,)."""
        return np.asarray(self.demonstrations.actions[item][:timestep].sum(axis=0), np.float32)

    def _previous(self, item: int, timestep: int) -> npt.NDArray[np.float32]:
        """Returns the action before a timestep, float32 (A,)."""
        return np.asarray(self.demonstrations.actions[item][max(0, timestep - 1)] * (timestep > 0), np.float32)

    def _frames(self, trajectory: Ints, timestep: Ints) -> dict[str, Tensor]:
        """Returns frames uint8 (N, H, W, C), by camera."""
        places = [(item, slice(at, at + 1)) for item, at in zip(trajectory.tolist(), timestep.tolist(), strict=True)]
        return self.demonstrations.frames_at(places, self.device)

    def _seen(self, network: SkillsNetwork, trajectory: Ints, timestep: Ints, views: Views) -> tuple[Tensor, Tensor]:
        """Returns pixels of views, and by how much keypoints moved in each, float32 (N, 2)."""
        ((camera, frames),) = self._frames(trajectory, timestep).items()
        seen, moved = views.of(frames)
        return network.pixels({camera: seen}), moved

    def _pixels(self, network: SkillsNetwork, trajectory: Ints, timestep: Ints) -> Tensor:
        return network.pixels(self._frames(trajectory, timestep))

    def _skills(self, steps: SkillSteps) -> Tensor:
        return functional.one_hot(self._tensor(steps.skill), len(self.spec.skills)).float()

    def _tensor(self, array: npt.NDArray[np.generic]) -> Tensor:
        return torch.from_numpy(array).to(self.device)


def _parts(count: int) -> list[slice]:
    """Returns slices of timesteps whose frames are encoded at once."""
    return [slice(start, start + _FRAMES_AT_ONCE) for start in range(0, count, _FRAMES_AT_ONCE)]


def relative_error(predicted: Tensor, target: Tensor) -> Tensor:
    """Returns the mean over the last axis of absolute errors, float (..., D), smaller where the target is far.

    An error of a target of 2 counts half, and that of a larger one in proportion to it.
    """
    return ((predicted - target).abs() / (1 + target.abs() / 2)).mean(dim=-1)


def heat_map_cross_entropy(logits: Tensor, centres: Tensor, keypoint: Tensor, *, width: Tensor) -> Tensor:
    """Returns the cross-entropy of a heat map and a Gaussian around a keypoint: float (N,).

    Args:
        logits: Of cells, float (N, cells).
        centres: Positions of the cells, float (cells, 2).
        keypoint: float (N, 2).
        width: Standard deviation along each axis, float (2,).
    """
    offsets = (centres - keypoint[:, None]) / width  # (N, cells, 2)
    target = (-offsets.square().sum(dim=2) / 2).softmax(dim=1)
    return -(target * logits.log_softmax(dim=1)).sum(dim=1)
