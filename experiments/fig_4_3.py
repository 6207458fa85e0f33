"""Figure 4.3: where the grounding model finds what a phrase names, in pictures, and how many pixels it is off."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from experiments.chapter4.places_in_frames import Found, find_blocks
from experiments.robustness import scenes
from experiments.robustness.confidence import by_trial
from experiments.robustness.draw import Scenes, open_or_draw
from experiments.robustness.reward_model import COLOURS, PHRASES, grounding_version
from experiments.robustness.worlds import NOMINAL, SCATTERED
from experiments.workbench import claims
from experiments.workbench.arms import Arm, Experiment
from experiments.workbench.configs import Config
from experiments.workbench.plots import new_figure, png
from experiments.workbench.results import ArmResult, Outcome, Sample
from experiments.workbench.table import Picture, Section, Table, words

_METHOD, _VERSION = "grounding", 1
_NEAR_PIXELS = 4.0
ERROR, NEAR, PRESENT = "error", "near", "present"
_SHOWN_SCENES, _INCHES = 3, 1.6


class Localisation(Experiment):
    """An arm for scenes of two blocks, and one for those of four; the model that ships is evaluated."""

    @property
    def arms(self) -> tuple[Arm, ...]:
        """The arms; the number of blocks is the condition of the scenes."""
        return tuple(Arm(SCATTERED, _METHOD, {"scenes": spec.blocks}) for spec in scenes.nominal_specs())

    def config(self, arm: Arm) -> Config:
        """Returns the scenes and the model."""
        return {"version": _VERSION, "grounding": grounding_version(), "test": _spec(arm.options["scenes"])}

    def prepare(self, arm: Arm, work: Path) -> bool:
        """Draws the scenes."""
        open_or_draw(_spec(arm.options["scenes"]), work)
        return True

    def run(
        self, arm: Arm, *, results: Path, work: Path, folder: Path, on_progress: Callable[[], None]
    ) -> Outcome | None:
        """Compares places; see `Experiment`."""
        drawn = open_or_draw(_spec(arm.options["scenes"]), work)
        lengths = drawn.seen["lengths"]
        trial = np.repeat(np.arange(len(lengths)), lengths)
        return Outcome({}, dict(_samples(find_blocks(drawn), trial)))

    def table(self, results: Sequence[ArmResult]) -> Table:
        """Returns a row for each colour and number of blocks, and pictures of the first scenes."""
        header = (
            "scenes",
            "phrase",
            "mean error, pixels of 64",
            f"within {_NEAR_PIXELS:g} pixels, %",
            "said to be there, %",
        )
        return Table(
            title="Figure 4.3: where the grounding model finds things",
            text=words("fig_4_3"),
            sections=(Section(header, tuple(row for each in results for row in _rows(each))),),
            claims=tuple(
                claims.claim_of(
                    f"localisation_{each.options['scenes']}",
                    [each],
                    [each.samples[ERROR]],
                    seeds=1,
                    command="python -m experiments run fig_4_3",
                )
                for each in results
            ),
            picture=Picture("Frames, and the heat of each phrase in them", partial(_picture, results[-1])),
        )


def _spec(blocks: str) -> Scenes:
    return scenes.scene_specs()[NOMINAL, blocks]


def _samples(found: Found, trial: np.ndarray) -> Iterator[tuple[str, Sample]]:
    """Yields mean error, share of near places, and share that is said to be there, of what is on show, by episode."""
    for column, colour in enumerate(COLOURS):
        shown = found.is_shown[:, column]
        yield f"{ERROR}.{colour}", by_trial(found.errors[:, column] * shown, shown, trial)
        yield f"{NEAR}.{colour}", by_trial((found.errors[:, column] < _NEAR_PIXELS) & shown, shown, trial)
        is_said = found.located.presence[:, column] >= 0.5
        yield f"{PRESENT}.{colour}", by_trial(is_said & shown, shown, trial)
    yield ERROR, by_trial((found.errors * found.is_shown).sum(axis=1), found.is_shown.sum(axis=1), trial)


def _rows(result: ArmResult) -> Iterator[tuple[str, ...]]:
    for colour, phrase in zip(COLOURS, PHRASES, strict=True):
        error, near, present = (result.samples[f"{name}.{colour}"].mean for name in (ERROR, NEAR, PRESENT))
        yield result.options["scenes"], phrase, f"{error:.2f}", f"{100 * near:.1f}", f"{100 * present:.1f}"


def _picture(result: ArmResult) -> bytes:
    """Returns the first scenes, drawn again, each with the heat of every phrase, the true place and the one found."""
    drawn = Scenes(_SHOWN_SCENES, _spec(result.options["scenes"]).seed, result.options["scenes"]).draw()
    found = find_blocks(drawn)
    frames = drawn.seen["frames"]
    figure = new_figure(_INCHES * (1 + len(PHRASES)), _INCHES * len(frames))
    grid = figure.subplots(len(frames), 1 + len(PHRASES))
    for row, frame in zip(range(len(frames)), frames, strict=True):
        grid[row, 0].imshow(frame)
        for column, phrase in enumerate(PHRASES):
            axes = grid[row, 1 + column]
            axes.imshow(found.located.heatmaps[row, column], cmap="gray", extent=(0, frame.shape[1], frame.shape[0], 0))
            axes.plot(found.located.x[row, column] * frame.shape[1], found.located.y[row, column] * frame.shape[0], "x")
            if found.is_shown[row, column]:
                axes.plot(*found.places[row, column], "o", fillstyle="none")
            axes.set_title(phrase if not row else "", fontsize="x-small")
    for axes in grid.flat:
        axes.set_axis_off()
    return png(figure)


EXPERIMENT = Localisation()
