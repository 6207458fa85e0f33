"""The learner of a reward model (section 4.2), on captions of the grounding model."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freerein.learning import weights
from freerein.learning.optimiser import fit_step
from freerein.learning.train_state import TrainState
from freerein_reward.goal_text import words
from freerein_reward.model import DualEncoder, DualEncoderSpec, GradCamModel, channels_last
from freerein_reward.objectives import contrastive_loss, relation_cross_entropy
from freerein_reward.relations import CANONICAL_WORDINGS, SpatialRelation
from freerein_reward.training.caption_dataset import (
    NO_CAPTION,
    CaptionDataset,
    flatten_pairs,
    ordered_pairs,
    relation_captions,
)
from freerein_reward.training.config import RewardConfig

State = TrainState[DualEncoder]

SIDES = ("further left than", "further right than")
"""Table 4.1's first two criteria, which hold at any distance: an auxiliary task for left and right."""

_MAX_SHIFT = 4
_IMAGES_AT_ONCE = 256
_STEEPNESS = 16.0
_HALF_HEAT = 0.75
"""Fraction of the presence heat at which an initialised keypoint is as likely present as absent."""


@dataclass(frozen=True, eq=False)
class RewardModelLearner:
    """A `freerein.learning.fit.Learner` of a dual encoder with keypoint pooling, initialised from `grounding`."""

    config: RewardConfig
    spec: DualEncoderSpec
    training: CaptionDataset
    validation: CaptionDataset
    grounding: GradCamModel
    grounding_version: str
    fingerprint: str
    device: torch.device

    @property
    def size(self) -> int:
        """Number of training images."""
        return len(self.training)

    def init(self, generator: torch.Generator) -> State:
        """Returns the initial state, with the image encoder of the grounding model."""
        network = DualEncoder(self.spec)
        weights.initialise(network, generator=generator)
        init_from_grounding(network, self.grounding, self.config.phrases)
        return TrainState.with_adam(channels_last(network.to(self.device)), self.config.lr, generator=generator)

    def update(self, state: State, items: npt.NDArray[np.int64]) -> tuple[State, dict[str, float]]:
        """Returns the state after one optimiser step on some images, and its `train_loss`."""
        rng = np.random.default_rng(int(torch.randint(2**31, (), generator=state.generator)))
        batch = _augment(self.training.subset(items), rng)
        return fit_step(state, _loss(state.network, batch), self.config)

    def evaluate(self, state: State) -> float:
        """Returns the cross-entropy of relations on the validation images."""
        targets = torch.from_numpy(flatten_pairs(self.validation.relations))
        return relation_cross_entropy(relation_scores(state.network, self.validation), targets).item()


def network_spec(grounding: DualEncoderSpec, config: RewardConfig) -> DualEncoderSpec:
    """Returns the architecture of a reward model: the grounding model's, with keypoint pooling."""
    texts = (*config.phrases, *CANONICAL_WORDINGS.values(), *SIDES)
    return replace(
        grounding,
        cameras=config.cameras,
        phrases=config.phrases,
        vocabulary=tuple(dict.fromkeys(word for text in texts for word in words(text))),
        keypoints=len(config.phrases) + config.extra_keypoints,
        hidden_size=config.hidden_size,
        embedding_dim=config.embedding_dim,
        presence_heat=1.0,
    )


@torch.no_grad()
def init_from_grounding(network: DualEncoder, grounding: GradCamModel, phrases: Sequence[str]) -> None:
    """Copies and freezes the grounding model's convolutions, and sets one keypoint per phrase to its Grad-CAM weights.

    The convolutions already detect colours and shapes; relations need no others. Both have one width and depth.
    """
    ours, theirs = network.image, grounding.network.image
    for module, source in ((ours.stem, theirs.stem), (ours.layer1, theirs.layer1), (ours.layer2, theirs.layer2)):
        module.load_state_dict(source.state_dict())
        module.requires_grad_(False)
    network.eval()
    scale = _STEEPNESS / grounding.network.spec.presence_heat
    logits = ours.keypoint_pool.logits
    logits.weight[: len(phrases)] = scale * grounding.channel_weights(phrases)
    logits.bias[: len(phrases)] = -_HALF_HEAT * _STEEPNESS


@torch.no_grad()
def relation_scores(network: DualEncoder, dataset: CaptionDataset) -> Tensor:
    """Returns the scaled cosines of images and canonical captions of each relation, float32 (N, pairs, 5)."""
    captions = relation_captions(dataset.phrases, ordered_pairs(len(dataset.phrases)))
    texts = network.embed_texts(network.tokenize(captions))
    parts = torch.split(_stacked_views(dataset), _IMAGES_AT_ONCE)
    images = torch.cat([network.embed_images(part.to(network.device)) for part in parts])
    scores: Tensor = network.temperature(images @ texts.T).unflatten(1, (-1, len(SpatialRelation))).cpu()
    return scores


def _augment(batch: CaptionDataset, rng: np.random.Generator) -> CaptionDataset:
    """Returns randomly shifted images, half of them mirrored; several views cannot be mirrored consistently."""
    offsets = rng.integers(-_MAX_SHIFT, _MAX_SHIFT + 1, size=(len(batch), 2))
    shifted = batch.shifted(offsets, limit=_MAX_SHIFT)
    return shifted.mirrored(rng.random(len(batch)) < 0.5) if len(batch.views) == 1 else shifted


def _loss(network: DualEncoder, batch: CaptionDataset) -> Tensor:
    """Returns the contrastive loss over captions and their rivals, plus the cross-entropies of relations and sides.

    A caption that is true of several images is one column; the rivals of each caption are columns too.
    """
    relations = flatten_pairs(batch.relations)  # (N, all pairs)
    has_caption = (relations != NO_CAPTION).any(axis=0)
    pairs = ordered_pairs(len(batch.phrases))[has_caption]
    captions = (*relation_captions(batch.phrases, pairs), *_side_captions(batch.phrases, pairs))
    texts = network.embed_texts(network.tokenize(captions))
    images = network.embed_images(_stacked_views(batch).to(network.device))
    scores = network.temperature(images @ texts.T)  # (N, 7 pairs)
    scores, side_scores = scores.tensor_split([len(SpatialRelation) * len(pairs)], dim=1)  # (N, 5 pairs), (N, 2 pairs)
    targets, sides = (
        torch.from_numpy(values[:, has_caption]).to(network.device)  # (N, pairs)
        for values in (relations, flatten_pairs(batch.sides))
    )
    positives = (targets[:, :, None] == torch.arange(len(SpatialRelation), device=network.device)).flatten(start_dim=1)
    return (
        contrastive_loss(scores, positives)
        + relation_cross_entropy(scores.unflatten(1, (-1, len(SpatialRelation))), targets)
        + relation_cross_entropy(side_scores.unflatten(1, (-1, len(SIDES))), sides)
    )


def _side_captions(phrases: Sequence[str], pairs: npt.NDArray[np.int64]) -> tuple[str, ...]:
    return tuple(f"{phrases[first]} {side} {phrases[second]}" for first, second in pairs for side in SIDES)


def _stacked_views(dataset: CaptionDataset) -> Tensor:
    """Returns uint8 (N, V, H, W, 3)."""
    return torch.from_numpy(np.stack(dataset.views, axis=1))
