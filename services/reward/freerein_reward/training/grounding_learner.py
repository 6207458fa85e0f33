"""The learner of the grounding model, on synthetic images of single objects."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from freerein.learning import weights
from freerein.learning.learner import Items, Learner, Losses
from freerein.learning.train_state import TrainState
from freerein_reward.model import DualEncoder, DualEncoderSpec, channels_last
from freerein_reward.training import synthetic_objects
from freerein_reward.training.config import GroundingConfig
from freerein_reward.training.evaluation import calibrate_presence
from freerein_reward.training.known_phrases import calibrate_known_phrases

State = TrainState[DualEncoder]


@dataclass(frozen=True, eq=False)
class ObjectBatch:
    """Synthetic images and captions.

    Attributes:
        images: uint8 (N, 1, H, W, 3).
        texts: K different captions.
        positives: bool (N, K), whether a caption is true of an image.
        objects: The object of each image, None for an empty one.
    """

    images: Tensor
    texts: tuple[str, ...]
    positives: Tensor
    objects: tuple[synthetic_objects.Attributes | None, ...]


@dataclass(frozen=True, eq=False)
class GroundingLearner(Learner[DualEncoder]):
    """The learner of a dual encoder with attention pooling; its data follow from `config`."""

    config: GroundingConfig
    device: torch.device
    fingerprint: str = ""

    @property
    def size(self) -> int:
        """Number of training images."""
        return self.config.train_images

    @cached_property
    def validation(self) -> ObjectBatch:
        """Validation images."""
        first = self.config.train_images
        items = range(first, first + self.config.validation_images)
        return self._batch(items, np.random.default_rng(self.config.seed))

    def init(self, generator: torch.Generator) -> State:
        """Returns the initial state."""
        spec = DualEncoderSpec(
            cameras=("",),
            vocabulary=synthetic_objects.VOCABULARY,
            image_size=synthetic_objects.IMAGE_SIZE,
            width=self.config.width,
            depth=self.config.depth,
            embedding_dim=self.config.embedding_dim,
        )
        network = DualEncoder(spec)
        weights.initialise(network, generator=generator)
        return TrainState.with_adam(channels_last(network.to(self.device)), self.config.lr, generator=generator)

    def loss(self, state: State, items: Items) -> Losses:
        """Returns the loss of some images."""
        seed = int(torch.randint(2**31, (), generator=state.generator))
        batch = self._batch(items.tolist(), np.random.default_rng(seed))
        return {"train_loss": _loss(state.network.train(), batch)}

    @torch.no_grad()
    def evaluate(self, state: State) -> float:
        """Returns the loss on the validation images."""
        return _loss(state.network.eval(), self.validation).item()

    def calibrate(self, network: DualEncoder) -> None:
        """Fits the heat from which a phrase counts as shown, and the score of phrases."""
        calibrate_presence(network, self)
        calibrate_known_phrases(network, self)

    def _batch(self, items: Sequence[int], rng: np.random.Generator) -> ObjectBatch:
        """Returns images that are rendered from their index, with random captions."""
        rendered = [synthetic_objects.render(np.random.default_rng((self.config.seed, item))) for item in items]
        objects = tuple(shown for _, shown in rendered)
        captions = dict(synthetic_objects.caption(shown, rng) for shown in objects)
        positives = [[_is_true(mentioned, shown) for mentioned in captions.values()] for shown in objects]
        images = torch.from_numpy(np.stack([image for image, _ in rendered])[:, None])
        return ObjectBatch(
            images.to(self.device), tuple(captions), torch.tensor(positives, device=self.device), objects
        )


def _is_true(mentioned: synthetic_objects.Attributes | None, shown: synthetic_objects.Attributes | None) -> bool:
    if mentioned is None or shown is None:
        return mentioned is shown
    return mentioned.describes(shown)


def _loss(network: DualEncoder, batch: ObjectBatch) -> Tensor:
    """Returns the mean contrastive loss of two image embeddings: attention-pooled and mean-pooled.

    The second makes Grad-CAM meaningful: cells without attention must not contradict the caption, and the few cells of
    an object must outweigh the others.
    """
    maps = network.image.feature_maps(batch.images[:, 0])
    texts = network.embed_texts(network.tokenize(batch.texts)).T
    pool = network.image.attention_pool
    embeddings = pool(maps), pool.cell_embeddings(maps).mean(dim=1)
    cosines = (functional.normalize(each, dim=1) @ texts for each in embeddings)  # (N, K)
    attention_loss, mean_loss = (contrastive_loss(network.temperature(each), batch.positives) for each in cosines)
    return (attention_loss + mean_loss) / 2


def contrastive_loss(scores: Tensor, positives: Tensor) -> Tensor:
    """Returns CLIP's symmetric loss with several positives each (SupCon), a scalar.

    Equal captions of a batch must be one column, so that they are not each other's negatives.

    Args:
        scores: Scaled similarities of images (rows) and texts (columns), float (N, K).
        positives: Whether a text is true of an image, bool (N, K).
    """
    return 0.5 * (multi_positive_cross_entropy(scores, positives) + multi_positive_cross_entropy(scores.T, positives.T))


def multi_positive_cross_entropy(scores: Tensor, positives: Tensor) -> Tensor:
    """Returns the mean cross-entropy with a uniform target over each row's positives; rows without are ignored."""
    log_probabilities = scores.log_softmax(dim=1)  # (N, K)
    counts = positives.sum(dim=1)  # (N,)
    losses = -log_probabilities.where(positives, 0.0).sum(dim=1) / counts.clamp(min=1)  # (N,)
    return losses.sum() / (counts > 0).sum().clamp(min=1)
