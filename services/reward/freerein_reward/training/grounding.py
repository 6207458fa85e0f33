"""The grounding model's training, as the resumable loop of `freerein.learning.fit` knows it."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn import functional

from freerein.learning import weights
from freerein.learning.checkpoints import JSON
from freerein.learning.optimiser import cosine_lr, optimiser_step
from freerein.learning.train_state import TrainState
from freerein_reward.model import DualEncoder, DualEncoderSpec
from freerein_reward.objectives import contrastive
from freerein_reward.training import objects
from freerein_reward.training.beginning import begin
from freerein_reward.training.config import GroundingConfig

State = TrainState[DualEncoder]


@dataclass(frozen=True, eq=False)
class Captioned:
    """Pictures, the captions that some of them got, and which caption is true of which picture.

    Attributes:
        images: uint8 (N, 1, H, W, 3).
        texts: K captions, no two of them equal.
        positives: bool (N, K).
        shown: The object of each picture; None for none.
    """

    images: Tensor
    texts: tuple[str, ...]
    positives: Tensor
    shown: tuple[objects.Attributes | None, ...]


@dataclass(frozen=True, eq=False)
class GroundingLearner:
    """A dual encoder to fit to pictures of single objects.

    Attributes:
        config: What was chosen.
        device: Where to compute.
    """

    config: GroundingConfig
    device: torch.device

    @property
    def size(self) -> int:
        """Pictures to learn from."""
        return self.config.images

    @property
    def identity(self) -> Mapping[str, JSON]:
        """What the result depends on."""
        return {"config": asdict(self.config)}

    @cached_property
    def held_out(self) -> Captioned:
        """Pictures to choose the best weights by."""
        numbers = range(self.config.images, self.config.images + self.config.held_out)
        return self._captioned(numbers, np.random.default_rng(self.config.seed))

    def init(self, generator: torch.Generator) -> State:
        """Returns the state before the first update."""
        spec = DualEncoderSpec(
            cameras=("",),
            vocabulary=objects.VOCABULARY,
            side=objects.SIDE,
            width=self.config.width,
            depth=self.config.depth,
            features=self.config.features,
        )
        network = DualEncoder(spec)
        weights.initialise(network, generator=generator)
        return begin(network, self.config.lr, generator=generator, device=self.device)

    def update(self, state: State, items: npt.NDArray[np.int64]) -> tuple[State, dict[str, float]]:
        """Returns the state after one update on some pictures, and its `train_loss`."""
        seed = int(torch.randint(2**31, (), generator=state.generator))
        batch = self._captioned(items.tolist(), np.random.default_rng(seed))
        loss = _loss(state.network.train(), batch)
        config = self.config
        rate = cosine_lr(config.lr, state.step, warmup_steps=config.warmup_steps, steps=config.steps)
        return optimiser_step(state, loss, lr=rate), {"train_loss": loss.item()}

    @torch.no_grad()
    def evaluate(self, state: State) -> float:
        """Returns the loss on the held-out pictures."""
        return _loss(state.network.eval(), self.held_out).item()

    def _captioned(self, numbers: Sequence[int], rng: np.random.Generator) -> Captioned:
        drawn = [objects.draw(np.random.default_rng((self.config.seed, number))) for number in numbers]
        said = dict(objects.caption(shown, rng) for _, shown in drawn)
        positives = [[_is_true(meaning, shown) for meaning in said.values()] for _, shown in drawn]
        images = torch.from_numpy(np.stack([image for image, _ in drawn])[:, None])
        shown = tuple(thing for _, thing in drawn)
        return Captioned(images.to(self.device), tuple(said), torch.tensor(positives, device=self.device), shown)


def _is_true(said: objects.Attributes | None, shown: objects.Attributes | None) -> bool:
    if said is None or shown is None:
        return said is shown
    return said.describes(shown)


def _loss(network: DualEncoder, batch: Captioned) -> Tensor:
    """Returns the contrastive loss of two embeddings of each picture: by attention, and with all cells counted alike.

    The second makes Grad-CAM worth looking at: what is not attended to must not say what is not there, and what is
    there must say so aloud, being a few cells among many.
    """
    ids = torch.from_numpy(network.tokenizer(batch.texts).ids).to(batch.images.device)
    maps, texts = network.image.maps(batch.images[:, 0]), network.embed_texts(ids).T
    embeddings = network.image.pool(maps), network.image.attention.cells(maps).mean(dim=1)
    cosines = (functional.normalize(each, dim=1) @ texts for each in embeddings)  # (N, K)
    attended, alike = (contrastive(network.temperature(each), batch.positives) for each in cosines)
    return (attended + alike) / 2
