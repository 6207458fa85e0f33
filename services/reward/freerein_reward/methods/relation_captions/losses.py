"""The learner of a reward model (section 4.2), on captions of the grounding model."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from freerein.goal_text import words
from freerein.learning import weights
from freerein.learning.augmentation import agreement, delayed
from freerein.learning.in_distribution import KNOWN_FRAMES
from freerein.learning.learner import Items, Learner, Losses
from freerein.learning.train_state import TrainState
from freerein_reward.methods.relation_captions.caption_dataset import (
    CAPTIONS,
    CaptionDataset,
    flatten_pairs,
    ordered_pairs,
    pair_captions,
)
from freerein_reward.methods.relation_captions.config import RewardConfig
from freerein_reward.model import DualEncoder, DualEncoderSpec, GradCamModel, PhraseLocator, channels_last

State = TrainState[DualEncoder]

_IMAGES_AT_ONCE = 256
_HEAT_FLOOR = 0.5
"""Heat from which a keypoint counts a cell at first, as a fraction of the peak heat of a phrase that is just shown."""


@dataclass(frozen=True, eq=False)
class RewardModelLearner(Learner[DualEncoder]):
    """The learner of a dual encoder of relations, initialised from `grounding` or from scratch.

    Batch normalisation has the statistics of the grounding model, or else those of the batches.

    Attributes:
        held_out_trajectories: Those that validation images are from; 0 where each shows a scene of its own.
    """

    config: RewardConfig
    spec: DualEncoderSpec
    training: CaptionDataset
    validation: CaptionDataset
    grounding: PhraseLocator
    grounding_version: str
    fingerprint: str
    device: torch.device
    held_out_trajectories: int = 0

    @property
    def size(self) -> int:
        """Number of training images."""
        return len(self.training)

    def init(self, generator: torch.Generator) -> State:
        """Returns the initial state, by default with the image encoder of the grounding model."""
        network = DualEncoder(self.spec)
        weights.initialise(network, generator=generator)
        if self.config.initial == "grounding":
            init_from_grounding(network, built_in(self.grounding), self.training)
        return TrainState.with_adam(channels_last(network.to(self.device)), self.config.lr, generator=generator)

    def loss(self, state: State, items: Items) -> Losses:
        """Returns the loss of some images."""
        batch = self._mirror(self.training.subset(items), state)
        network = state.network.train(self.config.initial == "scratch")
        scores = _scores(network, _stacked_views(batch), batch.phrases)
        loss = relation_cross_entropy(scores, _targets(batch).to(self.device))
        loss = loss + naming_loss(network, batch.phrases)
        if self.config.distillation:
            loss = loss + self.config.distillation * distillation_loss(network, batch)
        strength = delayed(self.config.augmentation, step=state.step, steps=self.config.steps)
        if strength:
            seen = batch.augmented(strength, generator=state.generator)
            loss = loss + agreement(_scores(network, _stacked_views(seen), batch.phrases), scores)
        return {"train_loss": loss}

    def evaluate(self, state: State) -> float:
        """Returns the cross-entropy of the captions of the validation images, as they are and augmented."""
        generator, strength = torch.Generator().manual_seed(self.config.seed), self.config.augmentation
        state.network.eval()
        seen = [self.validation]
        if strength:
            seen.append(self.validation.augmented(strength, generator=generator))
        losses = [relation_cross_entropy(caption_scores(state.network, each), _targets(each)) for each in seen]
        return torch.stack(losses).mean().item()

    @torch.no_grad()
    def calibrate(self, network: DualEncoder) -> None:
        """Fits the network's in-distribution score, to training images as they were seen and to held-out ones."""
        generator = torch.Generator().manual_seed(self.config.seed)
        sampled = np.linspace(0, self.size - 1, min(self.size, KNOWN_FRAMES)).round().astype(np.int64)
        known = self.training.subset(sampled).augmented(self.config.augmentation, generator=generator)
        network.eval()
        confidence = caption_scores(network, self.validation).softmax(dim=2).amax(dim=2)  # (N, pairs), an answer each
        held_out = network.statistics(_stacked_views(self.validation))
        if network.in_distribution is None:
            raise TypeError("This network has no in-distribution score; expected a model of relations.")
        known_views = network.statistics(_stacked_views(known))
        parts = (each.to(self.device) for each in (known_views, held_out, confidence.flatten()))
        network.in_distribution.fit(
            *parts,
            trajectories=self.held_out_trajectories or len(self.validation),
            augmented=self.config.augmentation > 0,
        )

    def _mirror(self, batch: CaptionDataset, state: State) -> CaptionDataset:
        """Returns the batch with half of the images mirrored; not with several views, which would not fit together."""
        if len(batch.views) > 1:
            return batch
        return batch.mirrored(torch.randint(2, (len(batch),), generator=state.generator).bool().numpy())


def network_spec(grounding: DualEncoderSpec, config: RewardConfig) -> DualEncoderSpec:
    """Returns the architecture of a reward model: the grounding model's, with relation pooling."""
    texts = pair_captions(config.phrases, ordered_pairs(len(config.phrases)))
    return replace(
        grounding,
        cameras=config.cameras,
        phrases=config.phrases,
        vocabulary=tuple(dict.fromkeys(word for text in texts for word in words(text))),
        hidden_size=config.hidden_size,
        embedding_dim=config.embedding_dim,
        presence_heat=1.0,
        scores_colours=True,
    )


def built_in(grounding: PhraseLocator) -> GradCamModel:
    """Returns the grounding model if its weights fit a reward model's; a TypeError for one trained elsewhere."""
    if not isinstance(grounding, GradCamModel):
        raise TypeError("This grounding model was trained elsewhere; expected the built-in one.")
    return grounding


@torch.no_grad()
def init_from_grounding(network: DualEncoder, grounding: GradCamModel, dataset: CaptionDataset) -> None:
    """Copies the grounding model's convolutions, and gives each phrase a keypoint with its Grad-CAM weights.

    Batch normalisation keeps the statistics of the grounding model: the network stays in evaluation mode.
    """
    ours, theirs = network.image, grounding.network.image
    for module, source in ((ours.stem, theirs.stem), (ours.layer1, theirs.layer1), (ours.layer2, theirs.layer2)):
        module.load_state_dict(source.state_dict())
    network.eval()
    half_heat = torch.from_numpy(dataset.half_heat).float() * grounding.network.spec.presence_heat
    heat = ours.relation_pool.heat
    heat.weight.copy_(grounding.channel_weights(dataset.phrases) / half_heat[:, None])
    heat.bias.fill_(-_HEAT_FLOOR)


def distillation_loss(network: DualEncoder, dataset: CaptionDataset) -> Tensor:
    """Returns the mean squared distance of keypoints from those of the grounding model, a scalar (section 4.2)."""
    if dataset.keypoints is None:
        raise TypeError("These images have no keypoints; expected those that captions were made from.")
    maps = network.image.feature_maps(torch.from_numpy(dataset.views[0]).to(network.device))
    taught = torch.from_numpy(dataset.keypoints).to(network.device, torch.float32)
    return functional.mse_loss(network.image.relation_pool.keypoints(maps), taught)


@torch.no_grad()
def caption_scores(network: DualEncoder, dataset: CaptionDataset) -> Tensor:
    """Returns the scaled similarity of images and the captions of each pair, float32 (N, pairs, `CAPTIONS`)."""
    parts = torch.split(_stacked_views(dataset), _IMAGES_AT_ONCE)
    return torch.cat([_scores(network, part, dataset.phrases).cpu() for part in parts])


def naming_loss(network: DualEncoder, phrases: Sequence[str]) -> Tensor:
    """Returns the cross-entropy of the phrases that each caption names first and second; they are known from its text.

    Without it, images alone must separate the captions of a pair before any relation can be learned.
    """
    pairs = ordered_pairs(len(phrases))
    states = network.text.states(network.tokenize(pair_captions(phrases, pairs)))  # (pairs * CAPTIONS, C)
    named = torch.from_numpy(pairs).repeat_interleave(CAPTIONS, dim=0).to(network.device)  # (pairs * CAPTIONS, 2)
    head = network.text.relation_head
    return functional.cross_entropy(head.first(states), named[:, 0]) + functional.cross_entropy(
        head.second(states), named[:, 1]
    )


def _targets(dataset: CaptionDataset) -> Tensor:
    """Returns the caption of each pair, int64 (N, pairs)."""
    return torch.from_numpy(flatten_pairs(dataset.relations))


def _scores(network: DualEncoder, views: Tensor, phrases: Sequence[str]) -> Tensor:
    texts = network.embed_texts(network.tokenize(pair_captions(phrases, ordered_pairs(len(phrases)))))
    images = network.embed_images(views.to(network.device))
    scores: Tensor = network.temperature(images @ texts.T).unflatten(1, (-1, CAPTIONS))
    return scores


def _stacked_views(dataset: CaptionDataset) -> Tensor:
    """Returns uint8 (N, V, H, W, 3)."""
    return torch.from_numpy(np.stack(dataset.views, axis=1))


def relation_cross_entropy(scores: Tensor, relations: Tensor) -> Tensor:
    """Returns the mean cross-entropy of each pair's relation among rival captions, which is what the reward decides.

    Args:
        scores: float (N, pairs, R), score of the caption with each relation.
        relations: int64 (N, pairs), true relation; -1 where the image has no caption of the pair.
    """
    loss = functional.cross_entropy(scores.flatten(end_dim=1), relations.flatten(), ignore_index=-1, reduction="sum")
    return loss / (relations >= 0).sum().clamp(min=1)
