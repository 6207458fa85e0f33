"""The reward model's training (section 4.2), as the resumable loop of `freerein.learning.fit` knows it."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freerein.learning import weights
from freerein.learning.checkpoints import JSON
from freerein.learning.optimiser import cosine_lr, optimiser_step
from freerein.learning.train_state import TrainState
from freerein_reward.model import DualEncoder, DualEncoderSpec, GroundingModel
from freerein_reward.model.tokenizer import words
from freerein_reward.objectives import contrastive, rivalry
from freerein_reward.relations import WORDINGS, Relation
from freerein_reward.training.beginning import adopt, begin
from freerein_reward.training.config import RewardConfig
from freerein_reward.training.described import UNSAID, Described, pairs_of, sentences, told_of

State = TrainState[DualEncoder]

SIDES = ("further left than", "further right than")
"""Table 4.1's first two criteria, which hold for things however far apart: what tells left from right when near."""

_MAX_SHIFT = 4
_IMAGES_AT_ONCE = 256


@dataclass(frozen=True, eq=False)
class RewardLearner:
    """A dual encoder to fit to captions of images, and other images to choose the best weights by.

    Attributes:
        config: What was chosen.
        spec: The network.
        training: To learn from.
        validation: Held out.
        grounding: The model that told the captions, as which the network begins to see.
        fingerprint: Of the dataset, and of the grounding model that told the captions.
        device: Where to compute.
    """

    config: RewardConfig
    spec: DualEncoderSpec
    training: Described
    validation: Described
    grounding: GroundingModel
    fingerprint: str
    device: torch.device

    @property
    def size(self) -> int:
        """Images to learn from."""
        return len(self.training)

    @property
    def identity(self) -> Mapping[str, JSON]:
        """What the result depends on."""
        config: dict[str, JSON] = json.loads(json.dumps(asdict(self.config)))  # as a checkpoint holds it: with lists
        return {"config": config, "data": self.fingerprint}

    def init(self, generator: torch.Generator) -> State:
        """Returns the state before the first update: what is where is seen, and relations are to be learnt."""
        network = DualEncoder(self.spec)
        weights.initialise(network, generator=generator)
        adopt(network, self.grounding, self.config.phrases)
        return begin(network, self.config.lr, generator=generator, device=self.device)

    def update(self, state: State, items: npt.NDArray[np.int64]) -> tuple[State, dict[str, float]]:
        """Returns the state after one update on some images, and its `train_loss`."""
        rng = np.random.default_rng(int(torch.randint(2**31, (), generator=state.generator)))
        batch = _augmented(self.training.subset(items), rng)
        loss = _loss(state.network, batch, rng)
        config = self.config
        rate = cosine_lr(config.lr, state.step, warmup_steps=config.warmup_steps, steps=config.steps)
        return optimiser_step(state, loss, lr=rate), {"train_loss": loss.item()}

    def evaluate(self, state: State) -> float:
        """Returns how badly the held-out images' captions win over their rivals."""
        return rivalry(
            score(state.network, self.validation), torch.from_numpy(told_of(self.validation.relations))
        ).item()


def design(grounding: DualEncoderSpec, config: RewardConfig) -> DualEncoderSpec:
    """Returns the network that fits the captions: the grounding model's towers, asking for places."""
    said = (*config.phrases, *(wording for wordings in WORDINGS.values() for wording in wordings), *SIDES)
    return replace(
        grounding,
        cameras=config.cameras,
        vocabulary=tuple(dict.fromkeys(word for text in said for word in words(text))),
        heads=len(config.phrases) + config.further_heads,
        hidden=config.hidden,
        features=config.features,
        presence_at=1.0,
    )


@torch.no_grad()
def score(network: DualEncoder, described: Described) -> Tensor:
    """Returns the scaled cosines of images and the usual sentences of each relation, float32 (N, pairs, 5)."""
    device = network.temperature.log_scale.device
    texts = _embed(network, sentences(described.phrases, pairs_of(len(described.phrases))))
    views = _views(described)
    images = [network.embed_images(some.to(device)) for some in torch.split(views, _IMAGES_AT_ONCE)]
    scores: Tensor = network.temperature(torch.cat(images) @ texts.T).unflatten(1, (-1, len(Relation))).cpu()
    return scores


def _augmented(batch: Described, rng: np.random.Generator) -> Described:
    """Returns the images moved a little, and half of them in a mirror; a mirror is only one where there is one view."""
    offsets = rng.integers(-_MAX_SHIFT, _MAX_SHIFT + 1, size=(len(batch), 2))
    moved = batch.shifted(offsets, most=_MAX_SHIFT)
    return moved.mirrored(rng.random(len(batch)) < 0.5) if len(batch.views) == 1 else moved


def _loss(network: DualEncoder, batch: Described, rng: np.random.Generator) -> Tensor:
    """Returns the contrastive loss over all captions of the batch and their rivals, and how the rivals alone are told.

    A caption that is right for several images is one column; the rivals of each caption are columns, whether or not
    they are right for an image of the batch.
    """
    device = network.temperature.log_scale.device
    captions = told_of(batch.relations)  # (N, all pairs)
    shown = (captions != UNSAID).any(axis=0)
    pairs = pairs_of(len(batch.phrases))[shown]
    texts = _embed(network, (*sentences(batch.phrases, pairs, rng=rng), *_side_sentences(batch.phrases, pairs)))
    scores = network.temperature(network.embed_images(_views(batch).to(device)) @ texts.T)  # (N, 7 pairs)
    scores, beside = scores.tensor_split([len(Relation) * len(pairs)], dim=1)  # (N, 5 pairs), (N, 2 pairs)
    told = torch.from_numpy(captions[:, shown]).to(device)  # (N, pairs)
    sides = torch.from_numpy(told_of(batch.sides)[:, shown]).to(device)  # (N, pairs)
    positives = (told[:, :, None] == torch.arange(len(Relation), device=device)).flatten(start_dim=1)
    return (
        contrastive(scores, positives)
        + rivalry(scores.unflatten(1, (-1, len(Relation))), told)
        + rivalry(beside.unflatten(1, (-1, len(SIDES))), sides)
    )


def _side_sentences(phrases: Sequence[str], pairs: npt.NDArray[np.int64]) -> tuple[str, ...]:
    return tuple(f"{phrases[first]} {side} {phrases[second]}" for first, second in pairs for side in SIDES)


def _embed(network: DualEncoder, texts: Sequence[str]) -> Tensor:
    device = network.temperature.log_scale.device
    return network.embed_texts(torch.from_numpy(network.tokenizer(texts).ids).to(device))


def _views(described: Described) -> Tensor:
    """Returns uint8 (N, V, H, W, 3)."""
    return torch.from_numpy(np.stack(described.views, axis=1))
