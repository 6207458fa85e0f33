"""A study: the demonstrations of one world, and the methods that are compared on them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from experiments.segmentation.dataset import DatasetSpec
from experiments.segmentation.effects import Effect
from experiments.workbench.arms import Arm
from freerein.learning.checkpoints import JSON
from freerein_segmentation.model import Context
from freerein_segmentation.training import SegmentationConfig

SUPERVISED = "supervised"
"""Method of the ceiling: cross-entropy on true labels."""

ACTION_STEPS = 500

_CONTEXTS: Mapping[str, Context] = MappingProxyType({"causal": 0, "bidirectional": "all"})


@dataclass(frozen=True)
class Method:
    """A way to train the segmentation network.

    Attributes:
        name: Its name in tables and arms.
        contexts: Contexts of the network that it is trained in; see `context_of`.
        settings: Keys of the segmentation service's configuration that it alone sets; `SUPERVISED` needs none.
        sees_frames: Whether frames are shown to its networks as they are; otherwise all are black.
        effects: Effects on test frames under which its networks are evaluated, too; see `effects`.
        seeds: Number of its networks, where it is another than the study's.
    """

    name: str
    contexts: tuple[str, ...]
    settings: Mapping[str, JSON] = field(default_factory=dict)
    sees_frames: bool = True
    effects: Mapping[str, Effect] = field(default_factory=dict)
    seeds: int | None = None


@dataclass(frozen=True)
class Study:
    """Methods on the demonstrations of one world.

    Attributes:
        data: The demonstrations.
        methods: The methods.
        seeds: Number of independently trained networks of each method and context.
        settings: Keys of the segmentation service's configuration that all methods share.
        train_evaluated: Number of training trajectories that are evaluated.
        guesses: Names of the baselines without a network; see `guesses.GUESSES`.
        learning_rates: What each method and context tries first in shorter fits, before the first of its seeds, unless
            it has one of its own; see `trials`. Empty: `settings` has the learning rate.
        trial_steps: Optimiser steps of these fits.
        action_steps: Optimiser steps of the network that clones actions, for `evaluation.ACTION_LOSS`.
    """

    data: DatasetSpec
    methods: tuple[Method, ...]
    seeds: int
    settings: Mapping[str, JSON]
    train_evaluated: int
    guesses: tuple[str, ...] = ("random", "random_cls", "majority")
    learning_rates: tuple[float, ...] = ()
    trial_steps: int = 0
    action_steps: int = ACTION_STEPS

    @property
    def world(self) -> str:
        """Task of the sim service."""
        return self.data.task

    @property
    def arms(self) -> tuple[Arm, ...]:
        """Guesses, then all networks of a seed before those of the next."""
        guesses = [Arm(self.world, name) for name in self.guesses]
        networks = [
            Arm(self.world, method.name, {"context": context}, seed)
            for seed in range(max(map(self._seeds_of, self.methods)))
            for method in self.methods
            if seed < self._seeds_of(method)
            for context in method.contexts
        ]
        return (*guesses, *networks)

    @property
    def trajectories_seen(self) -> int:
        """Number of training trajectories that a network is trained on."""
        config = SegmentationConfig.from_mapping(self.settings)
        return min(config.steps * config.batch_size, self.data.train.count)

    def is_guess(self, arm: Arm) -> bool:
        """Returns whether the arm trains no network."""
        return arm.method in self.guesses

    def tries_learning_rates(self, arm: Arm) -> bool:
        """Returns whether the learning rate of an arm's network has yet to be chosen."""
        return bool(self.learning_rates) and "lr" not in self._method(arm).settings

    def sees_frames(self, arm: Arm) -> bool:
        """Returns whether an arm's network is shown frames as they are."""
        return self._method(arm).sees_frames

    def effects(self, arm: Arm) -> Mapping[str, Effect]:
        """Returns the effects on test frames under which an arm's network is evaluated, too."""
        return self._method(arm).effects

    def fit_config(self, arm: Arm) -> SegmentationConfig:
        """Returns the configuration of an arm's network; see `tries_learning_rates`."""
        context = context_of(arm.options["context"])
        values = {**self.settings, **self._method(arm).settings, "context": context, "seed": arm.seed}
        return SegmentationConfig.from_mapping(values)

    def _seeds_of(self, method: Method) -> int:
        return self.seeds if method.seeds is None else method.seeds

    def _method(self, arm: Arm) -> Method:
        context = arm.options["context"]
        (method,) = (each for each in self.methods if each.name == arm.method and context in each.contexts)
        return method


def context_of(name: str) -> Context:
    """Returns the context that arms and tables call `causal`, `bidirectional`, or `lookahead-5` for 5 timesteps."""
    return _CONTEXTS[name] if name in _CONTEXTS else int(name.removeprefix("lookahead-"))
