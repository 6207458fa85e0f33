"""A training that tests kill, stop and resume: `python -m tests.freerein.line FOLDER`."""

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import torch
from torch import nn

from freerein.learning import weights
from freerein.learning.fit_config import FitConfig
from freerein.learning.learner import Items, Learner, Losses, Stage
from freerein.learning.train_state import TrainState
from freerein.learning.training_loop import fit, stop_on_sigterm

CONFIG = FitConfig(
    steps=12, batch_size=3, lr=0.1, warmup_steps=2, evaluate_every=4, checkpoint_every=5, log_every=3, seed=1, threads=1
)
STAGE_END = 5
CUT = 7


class Line(Learner[nn.Linear]):
    """Fits a line to noisy points, in two stages; noise is drawn during training, so that every generator matters.

    In the second stage points are elsewhere, by what is drawn as it begins.
    """

    size = 10

    def __init__(
        self, config: FitConfig = CONFIG, *, data: str = "points", before_update: Callable[[int], None] = lambda _: None
    ) -> None:
        self.config = config
        self.fingerprint = data
        self.before_update = before_update

    def init(self, generator: torch.Generator) -> TrainState[nn.Linear]:
        network = nn.Linear(1, 1)
        weights.initialise(network, generator=generator)
        return TrainState.with_adam(network, self.config.lr, generator=generator)

    def stages(self) -> tuple[Stage[nn.Linear], ...]:
        return (
            Stage("here", STAGE_END, self.loss),
            Stage("nowhere", 0, self.loss),
            Stage("elsewhere", self.config.steps - STAGE_END, self.loss, begin=self.move),
        )

    def move(self, state: TrainState[nn.Linear]) -> TrainState[nn.Linear]:
        return replace(state, carried={"offset": torch.randn(1, generator=state.generator)})

    def loss(self, state: TrainState[nn.Linear], items: Items) -> Losses:
        self.before_update(state.step)
        x = torch.from_numpy(items).float()[:, None]
        points = 2 * x + torch.randn(x.shape, generator=state.generator) + state.carried.get("offset", 0.0)
        return {"train_loss": (state.network(x) - points).square().mean()}

    def evaluate(self, state: TrainState[nn.Linear]) -> float:
        return (state.network.weight - 2).abs().item()


def main(folder: Path) -> None:
    """Trains, waiting for input before update CUT; prints how it ended."""

    def wait(step: int) -> None:
        if step == CUT:
            print(CUT, flush=True)  # noqa: T201
            sys.stdin.readline()

    with stop_on_sigterm() as stop:
        fitted = fit(Line(before_update=wait), folder, stop=stop)
    print("stopped" if fitted is None else "finished")  # noqa: T201


if __name__ == "__main__":
    main(Path(sys.argv[1]))
