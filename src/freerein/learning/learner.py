"""A learner: a network, its data, and the stages of its fit."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freerein.learning.fit_config import FitConfig
from freerein.learning.optimiser import cosine_lr, optimiser_step
from freerein.learning.train_state import N, TrainState

Items: TypeAlias = npt.NDArray[np.int64]
"""Numbers of the training items of a batch, int64 (B,)."""

Losses: TypeAlias = Mapping[str, Tensor]
"""`train_loss`, which an optimiser step lowers, and other losses to log, float () each."""


def unchanged(state: TrainState[N]) -> TrainState[N]:
    """Returns the state."""
    return state


@dataclass(frozen=True)
class Stage(Generic[N]):
    """Optimiser steps on one loss.

    Attributes:
        name: What it is called.
        steps: Optimiser steps; 0 leaves it out.
        loss: Returns the losses of a batch, always of the same names.
        begin: Returns the state that the first step starts from. It depends on the state alone: where a fit is killed
            before that step is saved, it is called again.
        shares_lr: Whether the learning rate's warm-up and decay are those of the whole fit, not of the stage.
    """

    name: str
    steps: int
    loss: Callable[[TrainState[N], Items], Losses]
    begin: Callable[[TrainState[N]], TrainState[N]] = unchanged
    shares_lr: bool = False


S = TypeVar("S", bound=Stage[Any])


def stage_at(stages: Sequence[S], step: int) -> tuple[int, S]:
    """Returns the number of steps before a stage, and the stage, that an optimiser step, counted from 0, is part of."""
    start = 0
    for stage in stages:
        if step < start + stage.steps:
            return start, stage
        start += stage.steps
    raise ValueError(f"A fit has {start} steps, from 0; got {step}.")


class Learner(ABC, Generic[N]):
    """A network, its data, and the stages of its fit, for the training loop.

    A learner of one stage has `loss`, one of several has `stages`.

    Attributes:
        config: The whole configuration of the fit.
        fingerprint: Fingerprint of the training data.
    """

    config: FitConfig
    fingerprint: str

    @property
    @abstractmethod
    def size(self) -> int:
        """Number of training items."""

    @abstractmethod
    def init(self, generator: torch.Generator) -> TrainState[N]:
        """Returns the initial state."""

    @abstractmethod
    def evaluate(self, state: TrainState[N]) -> float:
        """Returns the validation loss, from the training signal alone, never from ground-truth labels."""

    def loss(self, state: TrainState[N], items: Items) -> Losses:
        """Returns the losses of a batch, in a fit of one stage."""
        raise NotImplementedError

    def stages(self) -> Sequence[Stage[N]]:
        """Returns the stages of a fit, whose steps are those of the configuration; weights are chosen in the last."""
        return (Stage("training", self.config.steps, self.loss),)

    def calibrate(self, network: N) -> None:
        """Sets what a trained network takes from held-out data, after the last stage."""

    def update(self, state: TrainState[N], items: Items) -> tuple[TrainState[N], dict[str, float]]:
        """Returns the state after one optimiser step of its stage on a batch, and the losses."""
        start, stage = stage_at(self.stages(), state.step)
        if state.step == start:
            state = stage.begin(state)
        losses = stage.loss(state, items)
        first, steps = (0, self.config.steps) if stage.shares_lr else (start, stage.steps)
        lr = cosine_lr(self.config.lr, state.step - first, warmup_steps=self.config.warmup_steps, steps=steps)
        state = optimiser_step(state, losses["train_loss"], lr=lr)
        return state, {name: loss.item() for name, loss in losses.items()}
