"""The demo's figures: what was measured, and whether it meets its bar."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Figure:
    """One figure.

    Attributes:
        name: Its name in `summary.json`, such as `grid.frame_accuracy`.
        value: What was measured.
        at_least: What it must reach; None for a figure that only informs.
        above: What it must be greater than; None likewise.
        at_most: What it must stay below; None likewise.
    """

    name: str
    value: float
    at_least: float | None = None
    above: float | None = None
    at_most: float | None = None

    @property
    def met(self) -> bool | None:
        """Whether the bar is met; None where there is none."""
        if self.at_least is not None:
            return self.value >= self.at_least
        if self.above is not None:
            return self.value > self.above
        return None if self.at_most is None else self.value <= self.at_most

    @property
    def bar_text(self) -> str:
        """The bar as one reads it."""
        if self.at_least is not None:
            return f">= {self.at_least:.3f}"
        if self.above is not None:
            return f"> {self.above:.3f}"
        return "" if self.at_most is None else f"<= {self.at_most:.3f}"


def document(figures: Sequence[Figure], *, seed: int, begun_with: Mapping[str, Sequence[str]]) -> dict[str, object]:
    """Returns `summary.json`: each figure's value by name, and under `figures` its bar and whether it is met.

    Args:
        figures: What was measured.
        seed: Of every draw.
        begun_with: By stage, the models that came with freerein and that the stage did not learn itself.
    """
    bars = {
        figure.name: {"value": figure.value, "bar": figure.bar_text, "met": figure.met}
        for figure in figures
        if figure.met is not None
    }
    return {
        **{figure.name: figure.value for figure in figures},
        "seed": seed,
        "begun_with": begun_with,
        "figures": bars,
    }


def save(path: Path, summary: dict[str, object]) -> None:
    """Writes `summary.json`."""
    path.write_text(json.dumps(summary, indent=2) + "\n")
