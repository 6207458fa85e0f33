"""The learner of the segmentation network."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freerein import metrics
from freerein.learning import weights
from freerein.learning.action_scaling import ActionScaling
from freerein.learning.augmentation import agreement, augment_camera, delayed
from freerein.learning.fit import FitResult
from freerein.learning.image_statistics import image_statistics
from freerein.learning.in_distribution import KNOWN_FRAMES
from freerein.learning.inputs import spec_of
from freerein.learning.optimiser import fit_step
from freerein.learning.train_state import TrainState
from freerein.learning.trajectories import Trajectories
from freerein.types.common import ActionSpec, Camera
from freerein_segmentation.model import Context, ModelSpec, SegmentationNetwork
from freerein_segmentation.objectives import OBJECTIVES, Objective
from freerein_segmentation.objectives.labels import label_cross_entropy
from freerein_segmentation.objectives.set_likelihood import set_likelihood
from freerein_segmentation.training.batches import TrajectoryBatch, gather
from freerein_segmentation.training.confidence import Confidence
from freerein_segmentation.training.config import SegmentationConfig
from freerein_segmentation.training.self_training import Teacher, begin_round

State = TrainState[SegmentationNetwork]

_NORMALISATION_FRAMES = 2000
_ACTION_TRAJECTORIES = 400
"""Most trajectories that an action model is fitted to."""

_BEFORE_FINAL = "confidence"
"""What is carried from the start of the final objective on: the confidence of the network as it was."""


def network_spec(
    config: SegmentationConfig,
    *,
    cameras: tuple[Camera, ...],
    action: ActionSpec,
    skills: tuple[str, ...],
    action_scaling: ActionScaling | None = None,
) -> ModelSpec:
    """Returns the architecture for some cameras, and skills in the order of their labels.

    Raises:
        InvalidInput: Frames, actions or skills are out of bounds.
    """
    return spec_of(config, ModelSpec, cameras=cameras, action=action, skills=skills, action_scaling=action_scaling)


@dataclass(frozen=True, eq=False)
class SegmentationLearner:
    """A `freerein.learning.fit.Learner` of a segmentation network; `training` and `validation` have tags."""

    config: SegmentationConfig
    spec: ModelSpec
    training: Trajectories
    validation: Trajectories
    fingerprint: str
    device: torch.device

    @property
    def size(self) -> int:
        """Number of training trajectories."""
        return len(self.training)

    def init(self, generator: torch.Generator) -> State:
        """Returns the initial state; the encoder is normalised by the training frames."""
        network = SegmentationNetwork(self.spec)
        weights.initialise(network, generator=generator)
        sampled = self.training.sample_frames(_NORMALISATION_FRAMES)
        frames = {camera: torch.from_numpy(each) for camera, each in sampled.items()}
        network.image.fit_normalisation(frames, generator=generator)
        return TrainState.with_adam(network.to(self.device), self.config.lr, generator=generator)

    def update(self, state: State, items: npt.NDArray[np.int64]) -> tuple[State, dict[str, float]]:
        """Returns the state after one optimiser step on some trajectories, and its `train_loss`."""
        if state.step == self.config.final_from:
            state = self._begin_final(state)
        if state.step in self.config.round_starts:
            state = self._begin_round(state)
        batch, context = self._gather(items.tolist(), state.generator), self.config.context_at(state.step)
        scores, mask = state.network(batch.frames, batch.actions, batch.lengths, context=context)
        loss = self._loss(state, step=state.step)(scores, mask, batch).mean()
        strength = delayed(self.config.augmentation, step=state.step, steps=self.config.steps)
        if strength:
            seen = batch.augmented(strength, generator=state.generator)
            again, _ = state.network(seen.frames, seen.actions, seen.lengths, context=context)
            loss = loss + agreement(again[mask], scores[mask])
        return fit_step(state, loss, self.config)

    @torch.no_grad()
    def evaluate(self, state: State) -> float:
        """Returns the mean loss of the validation trajectories, on frames as they are and augmented ones.

        It is a loss of their tags: the objective, or the set likelihood once the final objective is trained. Labels of
        a teacher would favour the network that agrees with itself, whatever it says.
        """
        step = max(0, state.step - 1)
        objective, context = self._tag_objective(step=step), self.config.context_at(step)
        generator, strength = torch.Generator().manual_seed(self.config.seed), self.config.augmentation
        losses = []
        for batch in self._validation_batches():
            for seen in (batch, batch.augmented(strength, generator=generator)) if strength else (batch,):
                scores, mask = state.network(seen.frames, seen.actions, seen.lengths, context=context)
                losses.append(objective(scores, mask, seen.tags))
        return torch.cat(losses).mean().item()

    @torch.no_grad()
    def calibrate(self, network: SegmentationNetwork) -> None:
        """Fits the network's in-distribution score, to training frames as they were seen and to held-out ones."""
        generator = torch.Generator().manual_seed(self.config.seed)
        sampled = self.training.sample_frames(KNOWN_FRAMES)
        takes, strength = torch.arange(len(next(iter(sampled.values())))), self.config.augmentation
        frames = {
            camera: augment_camera(torch.from_numpy(each), takes, strength=strength, generator=generator).to(
                self.device
            )
            for camera, each in sampled.items()
        }
        held_out, confidence = [], []
        for batch in self._validation_batches():
            scores, mask = network(batch.frames, batch.actions, batch.lengths)
            held_out.append(image_statistics(batch.frames))
            confidence.append(scores[mask].softmax(dim=1).amax(dim=1))
        network.in_distribution.fit(
            image_statistics(frames), torch.cat(held_out), torch.cat(confidence), trajectories=len(self.validation)
        )

    @torch.no_grad()
    def tag_average_precision(self, network: SegmentationNetwork) -> dict[str, dict[str, float]]:
        """Returns the `average_precision` of each skill's tag among held-out trajectories, and that by `chance`.

        A trajectory's score is the skill's highest probability over time. Skills that all or none of them have are
        left out.
        """
        scores, tags = [], []
        for batch in self._validation_batches():
            each, mask = network(batch.frames, batch.actions, batch.lengths)
            scores.append(each.softmax(dim=2).masked_fill(~mask[:, :, None], 0).amax(dim=1).cpu())
            tags.append(batch.tags.cpu())
        found, truth = torch.cat(scores).numpy(), torch.cat(tags).numpy()  # (n, K) each
        return {
            skill: {
                "average_precision": metrics.average_precision(found[:, index], truth[:, index]),
                "chance": float(truth[:, index].mean()),
            }
            for index, skill in enumerate(self.spec.skills)
            if 0 < truth[:, index].sum() < len(truth)
        }

    def confidence(self, fitted: FitResult[SegmentationNetwork]) -> Confidence:
        """Returns the confidence on held-out timesteps, before the final objective where there is one.

        Both final objectives make a network sure, whatever it says: one by its teacher's labels, one by its entropy.
        """
        before = fitted.carried.get(_BEFORE_FINAL)
        return self._confidence(fitted.network, self.spec.context) if before is None else Confidence.of(before)

    @torch.no_grad()
    def _confidence(self, network: SegmentationNetwork, context: Context) -> Confidence:
        highest, tags = [], []
        for batch in self._validation_batches():
            scores, mask = network(batch.frames, batch.actions, batch.lengths, context=context)
            highest.append(scores[mask].softmax(dim=1).amax(dim=1))
            tags.append(batch.tags.sum(dim=1).repeat_interleave(batch.lengths))
        return Confidence.over(torch.cat(highest), torch.cat(tags))

    def _loss(self, state: State, *, step: int) -> Callable[[Tensor, Tensor, TrajectoryBatch], Tensor]:
        """Returns the loss of an optimiser step: of scores and mask, given the frames as they are, float (B,)."""
        config = self.config
        if config.round_starts and step >= config.round_starts[0]:
            teacher = Teacher.load(
                state.carried,
                self.spec,
                device=self.device,
                switching_cost=config.switching_cost,
                action_evidence=config.action_evidence,
                context=self._teacher_context(step),
            )
            return lambda scores, _mask, batch: label_cross_entropy(scores, teacher.label(batch))
        objective = self._tag_objective(step=step)
        return lambda scores, mask, batch: objective(scores, mask, batch.tags)

    def _tag_objective(self, *, step: int) -> Objective:
        return set_likelihood if step >= self.config.final_from else OBJECTIVES[self.config.objective]

    def _begin_final(self, state: State) -> State:
        before = self._confidence(state.network, self.config.context_at(state.step - 1))
        return replace(state, carried={_BEFORE_FINAL: before.tensor})

    def _begin_round(self, state: State) -> State:
        items = torch.randperm(self.size, generator=state.generator)[:_ACTION_TRAJECTORIES].tolist()
        size, context = self.config.batch_size, self._teacher_context(state.step)
        teacher = begin_round(
            state.network,
            (self._gather(items[at : at + size], state.generator) for at in range(0, len(items), size)),
            switching_cost=self.config.switching_cost,
            action_evidence=self.config.action_evidence,
            context=context,
            log_share=self._log_share() if context != self.spec.context else None,
            generator=state.generator,
        )
        return replace(state, carried={**teacher.tensors, _BEFORE_FINAL: state.carried[_BEFORE_FINAL]})

    def _teacher_context(self, step: int) -> Context:
        """Returns what the teacher at a step sees: as much as the network did that it was copied from."""
        copied_at = max(start for start in self.config.round_starts if start <= step)
        return self.config.context_at(copied_at - 1)

    def _log_share(self) -> Tensor:
        """Returns the logarithm of the share of training trajectories that have each skill, float32 (K,)."""
        counts = Counter(skill for skills in self.training.skills for skill in skills)
        shares = [max(1, counts[skill]) / self.size for skill in self.spec.skills]
        return torch.tensor(shares, device=self.device).log()

    def _gather(self, items: Sequence[int], generator: torch.Generator) -> TrajectoryBatch:
        """Returns training trajectories, each from a random phase of the stride on."""
        phases = torch.randint(self.spec.stride, (len(items),), generator=generator).tolist()
        return gather(self.training, items, phases, spec=self.spec, device=self.device)

    def _validation_batches(self) -> Iterator[TrajectoryBatch]:
        for start in range(0, len(self.validation), self.config.batch_size):
            items = range(start, min(start + self.config.batch_size, len(self.validation)))
            yield gather(self.validation, items, [0] * len(items), spec=self.spec, device=self.device)
