"""The learner of the segmentation network."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import torch
from torch import Tensor

from freerein import metrics
from freerein.learning import weights
from freerein.learning.augmentation import agreement, augment_camera, delayed
from freerein.learning.in_distribution import KNOWN_FRAMES
from freerein.learning.learner import Items, Learner, Losses, Stage, stage_at, unchanged
from freerein.learning.train_state import TrainState
from freerein.learning.training_loop import FitResult
from freerein.learning.trajectories import Trajectories
from freerein_segmentation.model import Context, ModelSpec, SegmentationNetwork
from freerein_segmentation.objectives import OBJECTIVES, Objective
from freerein_segmentation.training.algorithms import ALGORITHMS
from freerein_segmentation.training.batches import TrajectoryBatch, gather
from freerein_segmentation.training.confidence import CONFIDENCE, Confidence
from freerein_segmentation.training.config import SegmentationConfig

State = TrainState[SegmentationNetwork]

_NORMALISATION_FRAMES = 2000

BatchLoss: TypeAlias = Callable[[State, TrajectoryBatch, Tensor, Tensor], Tensor]
"""Given a state, a batch, scores f_t(k), float (B, T, K), and their mask, bool (B, T), returns losses, float (B,)."""


@dataclass(frozen=True, kw_only=True)
class TagStage(Stage[SegmentationNetwork]):
    """A stage, and how held-out trajectories are judged after its steps.

    Attributes:
        objective: Loss of their tags.
        context: Future timesteps, one stride apart, that scores depend on, in training, too.
    """

    objective: Objective
    context: Context


@dataclass(frozen=True, eq=False)
class SegmentationLearner(Learner[SegmentationNetwork]):
    """The learner of a segmentation network; `training` and `validation` have tags."""

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
        frames = self.training.sample_frames(_NORMALISATION_FRAMES)
        network.image.fit_normalisation(frames, generator=generator)
        return TrainState.with_adam(network.to(self.device), self.config.lr, generator=generator)

    def stages(self) -> tuple[TagStage, ...]:
        """Returns the stages of the configuration's algorithm."""
        return ALGORITHMS[self.config.final_objective](self)

    def before_final(self) -> TagStage:
        """Returns the stage before a final objective: the objective, which may see less of the future."""
        config = self.config
        steps = min(config.steps - 1, round((1 - config.final_share) * config.steps))
        return self.stage("objective", steps, OBJECTIVES[config.objective], context=config.context_before_final)

    def stage(
        self,
        name: str,
        steps: int,
        objective: Objective,
        *,
        context: Context,
        begin: Callable[[State], State] = unchanged,
        loss: BatchLoss | None = None,
    ) -> TagStage:
        """Returns a stage that trains a loss of scores, by default the objective of tags that judges it.

        Scores of augmented frames, once there are some, learn to agree with those of frames as they are.
        """

        def of_tags(_: State, batch: TrajectoryBatch, scores: Tensor, mask: Tensor) -> Tensor:
            return objective(scores, mask, batch.tags)

        def losses(state: State, items: Items) -> Losses:
            batch = self.batch(items.tolist(), state.generator)
            scores, mask = state.network(batch.frames, batch.actions, batch.lengths, context=context)
            total = (loss or of_tags)(state, batch, scores, mask).mean()
            strength = delayed(self.config.augmentation, step=state.step, steps=self.config.steps)
            if strength:
                seen = batch.augmented(strength, generator=state.generator)
                again, _ = state.network(seen.frames, seen.actions, seen.lengths, context=context)
                total = total + agreement(again[mask], scores[mask])
            return {"train_loss": total}

        return TagStage(name, steps, losses, begin, shares_lr=True, objective=objective, context=context)

    @torch.no_grad()
    def evaluate(self, state: State) -> float:
        """Returns the mean loss of the validation trajectories, on frames as they are and augmented ones.

        It is a loss of their tags: the objective, or the set likelihood once the final objective is trained. Labels of
        a teacher would favour the network that agrees with itself, whatever it says.
        """
        _, stage = stage_at(self.stages(), max(0, state.step - 1))
        losses = []
        for batch, others in zip(self._validation_batches(), self._other_views(), strict=True):
            for seen in (batch, *others):
                scores, mask = state.network(seen.frames, seen.actions, seen.lengths, context=stage.context)
                losses.append(stage.objective(scores, mask, seen.tags))
        return torch.cat(losses).mean().item()

    @torch.no_grad()
    def calibrate(self, network: SegmentationNetwork) -> None:
        """Fits the network's in-distribution score, to training frames as they were seen and to held-out ones."""
        generator = torch.Generator().manual_seed(self.config.seed)
        sampled = self.training.sample_frames(KNOWN_FRAMES)
        takes, strength = torch.arange(len(next(iter(sampled.values())))), self.config.augmentation
        frames = {
            camera: augment_camera(each, takes, strength=strength, generator=generator).to(self.device)
            for camera, each in sampled.items()
        }
        held_out, confidence = [], []
        for batch in self._validation_batches():
            scores, mask = network(batch.frames, batch.actions, batch.lengths)
            held_out.append(network.statistics(batch.frames))
            confidence.append(scores[mask].softmax(dim=1).amax(dim=1))
        network.in_distribution.fit(
            network.statistics(frames),
            torch.cat(held_out),
            torch.cat(confidence),
            trajectories=len(self.validation),
            augmented=strength > 0,
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
        before = fitted.carried.get(CONFIDENCE)
        return self._confidence(fitted.network, self.spec.context) if before is None else Confidence.of(before)

    @torch.no_grad()
    def _confidence(self, network: SegmentationNetwork, context: Context) -> Confidence:
        highest, tags = [], []
        for batch in self._validation_batches():
            scores, mask = network(batch.frames, batch.actions, batch.lengths, context=context)
            highest.append(scores[mask].softmax(dim=1).amax(dim=1))
            tags.append(batch.tags.sum(dim=1).repeat_interleave(batch.lengths))
        return Confidence.over(torch.cat(highest), torch.cat(tags))

    def carry_confidence(self, state: State, *, context: Context) -> State:
        """Returns a state that carries the confidence before the final objective, with the context until then."""
        confidence = self._confidence(state.network, context)
        return replace(state, carried={CONFIDENCE: confidence.tensor})

    def batch(self, items: Sequence[int], generator: torch.Generator) -> TrajectoryBatch:
        """Returns training trajectories, each from a random phase of the stride on."""
        phases = torch.randint(self.spec.stride, (len(items),), generator=generator).tolist()
        return gather(self.training, items, phases, spec=self.spec, device=self.device)

    def _other_views(self) -> Iterator[tuple[TrajectoryBatch, ...]]:
        """Yields augmented views of each batch of held-out trajectories, the same at every evaluation; none without."""
        generator, strength = torch.Generator().manual_seed(self.config.seed), self.config.augmentation
        for batch in self._validation_batches():
            yield (batch.augmented(strength, generator=generator),) if strength else ()

    def _validation_batches(self) -> Iterator[TrajectoryBatch]:
        for start in range(0, len(self.validation), self.config.batch_size):
            items = range(start, min(start + self.config.batch_size, len(self.validation)))
            yield gather(self.validation, items, [0] * len(items), spec=self.spec, device=self.device)
