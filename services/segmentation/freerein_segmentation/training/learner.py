"""Segmentation as the resumable loop of `freerein.learning.fit` knows it."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np
import numpy.typing as npt
import torch

from freerein.learning.checkpoints import JSON
from freerein.types.common import ActionSpec
from freerein_segmentation.model import ModelSpec
from freerein_segmentation.training.config import SegmentationConfig
from freerein_segmentation.training.demonstrations import Demonstrations, gather
from freerein_segmentation.training.updates import State, evaluate, init, update


def design(
    config: SegmentationConfig, *, frame: tuple[int, int, int], action: ActionSpec, skills: tuple[str, ...]
) -> ModelSpec:
    """Returns the network that fits demonstrations.

    Args:
        config: What was chosen.
        frame: H, W, C of the frames.
        action: What was executed.
        skills: All skills, in the order of their labels.

    Raises:
        InvalidInput: There is no network for such frames, actions or skills.
    """
    height, width, channels = frame
    return ModelSpec(
        skills=skills,
        camera=config.camera,
        height=height,
        width=width,
        channels=channels,
        action_size=action.size if config.use_actions else 0,
        action_choices=action.choices if config.use_actions else 0,
        stride=config.stride,
        context=config.context,
        features=config.features,
        hidden=config.hidden,
    )


@dataclass(frozen=True, eq=False)
class SegmentationLearner:
    """A network to fit to some demonstrations, and others to choose the best weights by.

    Attributes:
        config: What was chosen.
        spec: The network.
        training: To learn from.
        validation: Held out.
        fingerprint: Of the dataset.
        device: Where to compute.
    """

    config: SegmentationConfig
    spec: ModelSpec
    training: Demonstrations
    validation: Demonstrations
    fingerprint: str
    device: torch.device

    @property
    def size(self) -> int:
        """Trajectories to learn from."""
        return len(self.training)

    @property
    def identity(self) -> Mapping[str, JSON]:
        """What the result depends on."""
        return {"config": asdict(self.config), "data": self.fingerprint}

    def init(self, generator: torch.Generator) -> State:
        """Returns the state before the first update."""
        return init(self.config, self.spec, self.training, generator=generator, device=self.device)

    def update(self, state: State, items: npt.NDArray[np.int64]) -> tuple[State, dict[str, float]]:
        """Returns the state after one update on some trajectories, and its metrics."""
        phases = torch.randint(self.spec.stride, (len(items),), generator=state.generator).tolist()
        batch = gather(self.training, items.tolist(), phases, spec=self.spec, device=self.device)
        return update(state, batch, config=self.config)

    def evaluate(self, state: State) -> float:
        """Returns the loss on the held-out trajectories."""
        return evaluate(state, self.validation, config=self.config)
