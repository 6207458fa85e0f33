"""The goal-conditioned policy and the recognizer as the resumable loop of `freerein.learning.fit` knows them."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import torch

from freerein.learning.checkpoints import JSON
from freerein_imitation.model.goal_conditioned import GoalConditionedSpec
from freerein_imitation.training.exploration import Exploration
from freerein_imitation.training.goal_conditioned.config import GoalConditionedConfig
from freerein_imitation.training.goal_conditioned.updates import State, evaluate, init, update, windows


def design(config: GoalConditionedConfig, exploration: Exploration, *, action_choices: int) -> GoalConditionedSpec:
    """Returns the networks that fit the exploration.

    Args:
        config: What was chosen.
        exploration: Whose first trajectory shows the sizes.
        action_choices: How many different actions there are when they are discrete, else 0.
    """
    height, width, channels = exploration.frames[0].shape[1:]
    return GoalConditionedSpec(
        camera=config.camera,
        action_size=exploration.actions[0].shape[1],
        action_choices=action_choices,
        height=height,
        width=width,
        channels=channels,
        use_previous_action=config.use_previous_action,
        forward_model=config.forward_consistency > 0,
        features=config.features,
        hidden=config.hidden,
        embedding=config.embedding,
    )


@dataclass(frozen=True, eq=False)
class GoalConditionedLearner:
    """Networks to fit to some exploration, and more of it to choose the best weights by.

    Attributes:
        config: What was chosen.
        spec: The networks.
        training: To learn from.
        validation: Held out.
        fingerprint: Of the dataset.
        device: Where to compute.
    """

    config: GoalConditionedConfig
    spec: GoalConditionedSpec
    training: Exploration
    validation: Exploration
    fingerprint: str
    device: torch.device

    @cached_property
    def _windows(self) -> npt.NDArray[np.int64]:
        return windows(self.training, self.config)

    @property
    def size(self) -> int:
        """Windows to learn from."""
        return len(self._windows)

    @property
    def identity(self) -> Mapping[str, JSON]:
        """What the result depends on."""
        return {"config": asdict(self.config), "data": self.fingerprint}

    def init(self, generator: torch.Generator) -> State:
        """Returns the state before the first update."""
        return init(self.config, self.spec, self.training, generator=generator, device=self.device)

    def update(self, state: State, items: npt.NDArray[np.int64]) -> tuple[State, dict[str, float]]:
        """Returns the state after one update on some windows, and its metrics."""
        return update(state, self.training, self._windows[items].tolist(), config=self.config)

    def evaluate(self, state: State) -> float:
        """Returns the loss of the actions (eq. 3.2) and of the recognizer on held-out trajectories."""
        losses = evaluate(state.network, self.validation, config=self.config)
        return (losses.action + losses.recognition).item()
