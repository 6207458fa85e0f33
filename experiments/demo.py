"""What `freerein demo` shows: its parts are made in `freerein.cli.demo`, which ships; here their figures are kept."""

import asyncio
import json
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from experiments.workbench.arms import Arm, Experiment, world_version
from experiments.workbench.claims import Claim
from experiments.workbench.configs import Config
from experiments.workbench.plots import interval_plot
from experiments.workbench.results import ArmResult, Outcome
from experiments.workbench.table import Picture, Section, Table
from freerein.cli.demo.report import COLUMNS, Figure, Reporter
from freerein.cli.demo.run import run

_WORLDS = ("blocks", "dial", "grid")


class _Demo(Experiment):
    """One arm: the demo with seed 0, on services of its own."""

    arms: tuple[Arm, ...] = (Arm("blocks", "demo"),)

    def config(self, arm: Arm) -> Config:
        """Returns the versions of its worlds."""
        return {"worlds": [world_version(each) for each in _WORLDS]}

    def run(
        self, arm: Arm, *, results: Path, work: Path, folder: Path, on_progress: Callable[[], None]
    ) -> Outcome | None:
        """Runs the demo from its start, which takes minutes."""
        asyncio.run(run(folder / "demo", seed=arm.seed, reporter=Reporter(is_quiet=True), running=False))
        shown: dict[str, Any] = json.loads((folder / "demo" / "summary.json").read_bytes())
        return Outcome({name: each["value"] for name, each in shown["figures"].items()}, {}, shown)

    def table(self, results: Sequence[ArmResult]) -> Table:
        """Returns the figures as the demo prints them, and the seconds of its parts."""
        (result,) = results
        shown: Any = result.shown
        figures = [Figure(**each) for each in shown["figures"].values()]
        claims = [_claim(each, result) for each in figures]
        seconds = tuple((name, f"{each:.0f}") for name, each in shown["seconds"].items())
        return Table(
            title="The demo",
            text="What `freerein demo --seed 0` printed. Intervals are over trials. The last two results were learned "
            f"meanwhile, from random weights. `{result.name}.json` names the machine.",
            sections=(Section(COLUMNS, tuple(each.cells for each in figures)), Section(("part", "seconds"), seconds)),
            claims=tuple(claims),
            picture=Picture("Figures of the demo", partial(interval_plot, claims, title="The demo", unit="")),
        )


def _claim(figure: Figure, result: ArmResult) -> Claim:
    low, high = figure.interval or (None, None)
    return Claim(
        claim=figure.name.removeprefix("— "),
        value=figure.value,
        low=low,
        high=high,
        seeds=1,
        trials=1,
        baseline=figure.baseline,
        world_version=result.world_version,
        command=result.command,
        minutes=result.minutes,
    )


EXPERIMENT = _Demo()
