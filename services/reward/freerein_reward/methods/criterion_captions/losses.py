"""The learner of a model of criteria (section 4.2), on keypoints and captions of the grounding model.

Five losses:

- of keypoints: the cross-entropy of the cell where the grounding model found a phrase, or of nowhere. This is the
  distillation from the old model that section 4.2 speaks of.
- of captions: for each image and each caption whether it holds, sigmoid by sigmoid (Zhai et al., "Sigmoid loss for
  language image pre-training", 2023). Several captions hold of an image; those that are not sure are left out.
- of keypoints of all names that the grounding model knows, in other colours: see `recoloured_moments`.
- of captions of imagined keypoints, of which there are as many as one likes: see `imagined_keypoints`.
- from the first augmented step on, for other views of the same moments: of keypoints, which move with the frame, and of
  captions, which are to be scored as on the frames as they are.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn import functional

from freerein.goal_text import words
from freerein.learning import weights
from freerein.learning.augmentation import agreement, delayed
from freerein.learning.in_distribution import KNOWN_FRAMES
from freerein.learning.learner import Items, Learner, Losses
from freerein.learning.train_state import TrainState
from freerein_reward.methods.criterion_captions.augmented_moments import augment_moments
from freerein_reward.methods.criterion_captions.captions import (
    FALSE,
    SHOWN,
    TRUE,
    UNSURE,
    phrase_tuples,
    possible_captions,
    sampled_tuples,
)
from freerein_reward.methods.criterion_captions.config import CriterionConfig
from freerein_reward.methods.criterion_captions.decisions import answer_confidence
from freerein_reward.methods.criterion_captions.imagined_keypoints import imagine_keypoints
from freerein_reward.methods.criterion_captions.keypoint_dataset import KeypointDataset
from freerein_reward.methods.criterion_captions.locator import INITIAL_LOGIT, Located, target_distribution
from freerein_reward.methods.criterion_captions.network import MAX_NOUNS, CriterionNetwork
from freerein_reward.methods.criterion_captions.recoloured_moments import recolour_moments
from freerein_reward.methods.criterion_captions.spec import CriterionSpec
from freerein_reward.model import GradCamModel, channels_last

State = TrainState[CriterionNetwork]

_MOMENTS_AT_ONCE = 64
_RECOLOURED = 4
"""One moment in so many is seen in other colours, too."""

_IMAGINED = 256
"""Scenes of imagined keypoints per optimiser step."""


@dataclass(frozen=True, eq=False)
class CriterionLearner(Learner[CriterionNetwork]):
    """The learner of a model of criteria, initialised from `grounding`.

    Attributes:
        held_out_trajectories: Those that validation moments are from; 0 where each shows a scene of its own.
    """

    config: CriterionConfig
    spec: CriterionSpec
    training: KeypointDataset
    validation: KeypointDataset
    grounding: GradCamModel
    grounding_version: str
    fingerprint: str
    device: torch.device
    held_out_trajectories: int = 0

    @property
    def size(self) -> int:
        """Number of training moments."""
        return len(self.training)

    @property
    def tuples(self) -> npt.NDArray[np.int64]:
        """Pairs and triples of phrases whose captions tell how good a network is, int64 (T, 3)."""
        return sampled_tuples(len(self.spec.phrases), np.random.default_rng(self.config.seed))

    def init(self, generator: torch.Generator) -> State:
        """Returns the initial state, with text encoder, convolutions and heat of the grounding model."""
        network = CriterionNetwork(self.spec)
        weights.initialise(network, generator=generator)
        init_from_grounding(network, self.grounding)
        return TrainState.with_adam(channels_last(network.to(self.device)), self.config.lr, generator=generator)

    def loss(self, state: State, items: Items) -> Losses:
        """Returns the losses of some moments."""
        batch = self._mirror(self.training.subset(items), state)
        chosen = sampled_tuples(len(self.spec.phrases), state.rng())
        located = locate_all(state.network, stacked(batch), self.device)
        scores = caption_scores(state.network, located, chosen)
        captions = caption_loss(scores, self._labels(batch, chosen)) + self._imagined_loss(state)
        keypoints = keypoint_loss(located, batch)
        strength = delayed(self.config.augmentation, step=state.step, steps=self.config.steps)
        names = self._name_loss(state, batch.subset(np.arange(max(1, len(batch) // _RECOLOURED))), strength)
        losses = {"captions": captions, "places": keypoints, "names": names}
        augmented = captions.new_zeros(())
        if strength:
            seen = self._augment(batch, strength, state.generator)
            relocated = locate_all(state.network, stacked(seen), self.device)
            rescored = caption_scores(state.network, relocated, chosen)
            said = torch.from_numpy(possible_captions(chosen, batch.layout.views)).to(self.device)
            agreed = agreement(_binary(rescored[:, said]), _binary(scores[:, said]))
            augmented = keypoint_loss(relocated, seen) + agreed
        return {"train_loss": captions + keypoints + names + augmented, **losses, "augmented": augmented}

    @torch.no_grad()
    def evaluate(self, state: State) -> float:
        """Returns the losses of keypoints and captions of the validation moments, as they are and augmented."""
        generator, strength = torch.Generator().manual_seed(self.config.seed), self.config.augmentation
        seen = [self.validation, *([self._augment(self.validation, strength, generator)] if strength else [])]
        labels = self._labels(self.validation, self.tuples)
        losses = []
        for each in seen:
            located = locate_all(state.network, stacked(each), self.device)
            scores = caption_scores(state.network, located, self.tuples)
            losses.append(keypoint_loss(located, each) + caption_loss(scores, labels))
        return torch.stack(losses).mean().item()

    @torch.no_grad()
    def calibrate(self, network: CriterionNetwork) -> None:
        """Fits the network's in-distribution score, to training moments as they were seen and to held-out ones."""
        generator = torch.Generator().manual_seed(self.config.seed)
        sampled = np.linspace(0, self.size - 1, min(self.size, KNOWN_FRAMES)).round().astype(np.int64)
        known = self._augment(self.training.subset(sampled), self.config.augmentation, generator)
        located = locate_all(network, stacked(self.validation), self.device)
        confidence = answer_confidence(caption_scores(network, located, self.tuples), self.tuples, network.grammar)
        known_views = network.statistics(stacked(known))
        parts = (
            each.to(self.device) for each in (known_views, network.statistics(stacked(self.validation)), confidence)
        )
        network.in_distribution.fit(
            *parts,
            trajectories=self.held_out_trajectories or len(self.validation),
            augmented=self.config.augmentation > 0,
        )

    def _name_loss(self, state: State, batch: KeypointDataset, strength: float) -> Tensor:
        """Returns the loss of keypoints of all names that the grounding model knows, in moments of other colours."""
        names = [f"a {name} thing" for name in self.grounding.names]
        if not names:
            return torch.zeros((), device=self.device)
        least, generator = self.config.min_presence, state.generator
        turned = recolour_moments(batch, self.grounding, names, least=least, generator=generator)
        turned = self._augment(turned, strength, generator)
        noun = words(self.spec.phrases[state.step % len(self.spec.phrases)])[-1]
        phrases = [f"a {name} {noun}" for name in self.grounding.names]
        return keypoint_loss(locate_all(state.network, stacked(turned), self.device, phrases), turned)

    def _imagined_loss(self, state: State) -> Tensor:
        """Returns the loss of captions of imagined keypoints."""
        tuples = phrase_tuples(MAX_NOUNS)
        imagined = imagine_keypoints(_IMAGINED, self.training.layout, state.rng())
        scenes = replace(self.training, frames=(), keypoints=imagined.keypoints, shown=imagined.shown)
        keypoints, presence = (torch.from_numpy(each).to(self.device) for each in imagined[:2])
        return caption_loss(embedded_scores(state.network, keypoints, presence, tuples), self._labels(scenes, tuples))

    def _labels(self, batch: KeypointDataset, tuples: npt.NDArray[np.int64]) -> Tensor:
        labels = batch.captions(tuples, tolerance=self.config.tolerance)
        return torch.from_numpy(labels).to(self.device)

    def _augment(self, batch: KeypointDataset, strength: float, generator: torch.Generator) -> KeypointDataset:
        return augment_moments(batch, strength, distractors=self.config.distractors, generator=generator)

    def _mirror(self, batch: KeypointDataset, state: State) -> KeypointDataset:
        """Returns the batch with half of the moments mirrored, where that shows possible scenes."""
        if not batch.layout.is_mirrored:
            return batch
        return batch.mirrored(torch.randint(2, (len(batch),), generator=state.generator).bool().numpy())


@torch.no_grad()
def init_from_grounding(network: CriterionNetwork, grounding: GradCamModel) -> None:
    """Copies the grounding model's text encoder and convolutions, and lets phrases have the heat of Grad-CAM.

    A phrase's heat is relative to the mean of the names that the grounding model knows. Batch normalisation keeps the
    statistics of the grounding model: the network stays in evaluation mode.
    """
    theirs = grounding.network
    network.text.load_state_dict(theirs.text.state_dict())
    ours, pool = network.image, theirs.image.attention_pool
    for module, source in ((ours.stem, theirs.image.stem), (ours.layer1, theirs.image.layer1)):
        module.load_state_dict(source.state_dict())
    ours.layer2.load_state_dict(theirs.image.layer2.state_dict())
    network.cells.weight.copy_(pool.out.weight @ pool.value.weight)
    names = [f"a {name} thing" for name in grounding.names] or list(network.spec.phrases)
    network.locator.contrast.copy_(network.embed_phrases(names).mean(dim=0))
    network.locator.log_scale.copy_(torch.tensor(INITIAL_LOGIT / theirs.spec.presence_heat).log())
    network.eval()


def stacked(dataset: KeypointDataset) -> Tensor:
    """Returns the frames of all cameras, uint8 (N, V, H, W, 3)."""
    return torch.from_numpy(np.stack(dataset.frames, axis=1))


def locate_all(network: CriterionNetwork, views: Tensor, device: torch.device, phrases: Sequence[str] = ()) -> Located:
    """Returns where phrases, by default those of the fit, are in views, uint8 (N, V, H, W, 3)."""
    embedded = network.embed_phrases(phrases or network.spec.phrases)
    parts = [
        network.locate(network.embed_cells(part.to(device)), embedded) for part in torch.split(views, _MOMENTS_AT_ONCE)
    ]
    return Located(*(torch.cat(each) for each in zip(*parts, strict=True)))


def caption_scores(network: CriterionNetwork, located: Located, tuples: npt.NDArray[np.int64]) -> Tensor:
    """Returns the scaled similarity of images and captions, float32 (N, T, statements), of tuples int64 (T, 3)."""
    return embedded_scores(network, located.keypoints, located.presence, tuples)


def embedded_scores(
    network: CriterionNetwork, keypoints: Tensor, presence: Tensor, tuples: npt.NDArray[np.int64]
) -> Tensor:
    """Returns `caption_scores` of keypoints (N, V, K, 2) and presence (N, V, K)."""
    seen = network.embed_keypoints(keypoints, presence, torch.from_numpy(tuples).to(network.device))
    scores: Tensor = network.temperature(seen @ network.embed_statements().T)
    return scores


def caption_loss(scores: Tensor, labels: Tensor) -> Tensor:
    """Returns the mean sigmoid loss of captions that surely hold or surely do not.

    Those that hold weigh as much as those that do not, statement by statement: `on top of` seldom holds.

    Args:
        scores: float32 (N, T, statements).
        labels: int8 (N, T, statements), as of `label_captions`.
    """
    losses = functional.binary_cross_entropy_with_logits(scores, labels.clamp(min=0).float(), reduction="none")
    kinds = []
    for kind in (TRUE, FALSE):
        is_kind = labels == kind
        kinds.append((losses * is_kind).sum(dim=(0, 1)) / is_kind.sum(dim=(0, 1)).clamp(min=1))  # (statements,)
    return torch.stack(kinds).mean()


def keypoint_loss(located: Located, dataset: KeypointDataset) -> Tensor:
    """Returns the mean cross-entropy of the cell of each phrase, or of nowhere, over phrases that are sure."""
    device, side = located.logits.device, round((located.logits.shape[-1] - 1) ** 0.5)
    shown = torch.from_numpy(dataset.shown).to(device)  # (N, V, P)
    cells = target_distribution(torch.from_numpy(dataset.keypoints).to(device), height=side, width=side)
    is_shown = (shown == SHOWN)[..., None]
    targets = torch.cat([cells * is_shown, (~is_shown).float()], dim=-1)  # (N, V, P, S + 1)
    losses = -(targets * located.logits.log_softmax(dim=-1)).sum(dim=-1)
    is_sure = shown != UNSURE
    return (losses * is_sure).sum() / is_sure.sum().clamp(min=1)


def _binary(scores: Tensor) -> Tensor:
    """Returns sigmoid scores (...) as those of two classes (..., 2)."""
    return torch.stack([scores, torch.zeros_like(scores)], dim=-1)
