"""A training that tests kill, stop and resume: `python -m tests.freerein.line FOLDER`."""

import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from torch import nn

from freerein.learning import weights
from freerein.learning.fit import fit, stop_on_sigterm
from freerein.learning.fit_config import FitConfig
from freerein.learning.train_state import TrainState

CONFIG = FitConfig(steps=12, batch_size=3, evaluate_every=4, checkpoint_every=5, log_every=3, seed=1, threads=1)
CUT = 7


class Line:
    """Fits a line to noisy points; the noise is drawn during training, so that every generator's state matters."""

    def __init__(
        self, config: FitConfig = CONFIG, *, data: str = "points", before_update: Callable[[int], None] = lambda _: None
    ) -> None:
        self.config = config
        self.size = 10
        self.fingerprint = data
        self.before_update = before_update

    def init(self, generator: torch.Generator) -> TrainState[nn.Linear]:
        network = nn.Linear(1, 1)
        weights.initialise(network, generator=generator)
        return TrainState(network, torch.optim.Adam(network.parameters(), 0.1), generator)

    def update(
        self, state: TrainState[nn.Linear], items: npt.NDArray[np.int64]
    ) -> tuple[TrainState[nn.Linear], Mapping[str, float]]:
        self.before_update(state.step)
        x = torch.from_numpy(items).float()[:, None]
        noise = torch.randn(x.shape, generator=state.generator)
        loss = (state.network(x) - 2 * x - noise).square().mean()
        state.optimiser.zero_grad()
        loss.backward()
        state.optimiser.step()
        return replace(state, step=state.step + 1), {"train_loss": loss.item()}

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
