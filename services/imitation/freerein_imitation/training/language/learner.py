"""The language policy as the resumable loop of `freerein.learning.fit` knows it."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np
import numpy.typing as npt
import torch

from freerein.learning import weights
from freerein.learning.checkpoints import JSON
from freerein.learning.train_state import TrainState
from freerein_imitation.model.language import LanguageNetwork, LanguageSpec, differences
from freerein_imitation.model.text_tower import TextTower
from freerein_imitation.training.exploration import Exploration
from freerein_imitation.training.language.config import LanguageConfig
from freerein_imitation.training.language.rollouts import Rollouts, hold_out
from freerein_imitation.training.language.updates import State, evaluate, update

_CALIBRATION_FRAMES = 2000


@dataclass(frozen=True, eq=False)
class LanguageLearner:
    """A network to fit to rollouts, and more of them to choose the best weights by.

    Attributes:
        config: What was chosen.
        spec: The network.
        training: To learn from.
        validation: Held out.
        fingerprint: Of the dataset and the text tower.
        device: Where to compute.
    """

    config: LanguageConfig
    spec: LanguageSpec
    training: Rollouts
    validation: Rollouts
    fingerprint: str
    device: torch.device

    @property
    def size(self) -> int:
        """Timesteps to learn from."""
        return len(self.training)

    @property
    def identity(self) -> Mapping[str, JSON]:
        """What the result depends on."""
        return {"config": asdict(self.config), "data": self.fingerprint}

    def init(self, generator: torch.Generator) -> State:
        """Returns the state before the first update."""
        network = LanguageNetwork(self.spec)
        weights.initialise(network, generator=generator)
        frames = torch.from_numpy(self.training.exploration.spread(_CALIBRATION_FRAMES))
        network.calibrate(frames, self.training.different_codes())
        network = network.to(self.device)
        optimiser = torch.optim.Adam(network.parameters(), self.config.lr, fused=True)
        return TrainState(network, optimiser, generator)

    def update(self, state: State, items: npt.NDArray[np.int64]) -> tuple[State, dict[str, float]]:
        """Returns the state after one update on some timesteps, and its metrics."""
        return update(state, self.training, items, config=self.config)

    def evaluate(self, state: State) -> float:
        """Returns the loss of the actions on held-out trajectories: rewards and true states have no part in it."""
        return evaluate(state.network, self.validation)


def prepare(
    config: LanguageConfig,
    exploration: Exploration,
    texts: Sequence[str],
    tower: TextTower,
    *,
    action_choices: int,
    fingerprint: str,
    device: torch.device,
) -> LanguageLearner:
    """Returns the learner of distilling policies; reads every goal text once.

    Args:
        config: What was chosen.
        exploration: What the policies saw and did.
        texts: Of each trajectory, its goal text.
        tower: Makes codes of them.
        action_choices: How many different actions there are when they are discrete, else 0.
        fingerprint: Of the dataset and the text tower.
        device: Where to compute.

    Raises:
        InvalidInput: No goal text has two trajectories, or there is no network for these frames.
    """
    different = sorted(set(texts))
    codes = dict(zip(different, tower(different), strict=True))
    training, validation = hold_out(
        Rollouts(exploration, tuple(texts), codes), share=config.validation_fraction, seed=config.seed
    )
    directions = differences(training.different_codes()).shape[1]
    spec = design(config, exploration, action_choices=action_choices, text_width=tower.width, directions=directions)
    return LanguageLearner(config, spec, training, validation, fingerprint, device)


def design(
    config: LanguageConfig,
    exploration: Exploration,
    *,
    action_choices: int,
    text_width: int = 384,
    directions: int = 1,
) -> LanguageSpec:
    """Returns the network that fits rollouts, of which the first shows the sizes."""
    height, width, channels = exploration.frames[0].shape[1:]
    return LanguageSpec(
        camera=config.camera,
        text_width=text_width,
        directions=directions,
        action_size=exploration.actions[0].shape[1],
        action_choices=action_choices,
        height=height,
        width=width,
        channels=channels,
        features=config.features,
        words=config.words,
        hidden=config.hidden,
    )
