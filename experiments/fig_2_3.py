"""Figure 2.3: held-out trajectories, one of each robot's world, and the skills that our method finds in them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from experiments import table_2_2, table_2_4
from experiments.segmentation import draw
from experiments.segmentation.dataset import SPLITS
from experiments.segmentation.experiment import SHOWN_LABELS, SegmentationExperiment
from experiments.segmentation.rows import Rows
from experiments.segmentation.study import Study
from experiments.workbench.arms import Experiment
from experiments.workbench.plots import new_figure, png
from experiments.workbench.results import ArmResult
from experiments.workbench.table import Picture, Section, Table
from freerein import metrics

Labels = npt.NDArray[np.int64]

_SOURCES: Mapping[str, SegmentationExperiment] = {
    "table_2_2": table_2_2.EXPERIMENT,
    "table_2_4": table_2_4.EXPERIMENT,
}
_OURS = {target.world: target.rows for source in _SOURCES.values() for target in source.report.targets}
_FRAMES, _FRAME_INCHES, _WIDTH_INCHES = 8, 1.3, 11.0
_HEADER = ("world", "predicted skills, as [start, end)", "true skills", "frame accuracy, %")


@dataclass(frozen=True, eq=False)
class Shown:
    """A held-out trajectory.

    Attributes:
        world: Its world.
        skills: The world's skills.
        frames: uint8 (T, H, W, C).
        truth: True labels, int64 (T,).
        predicted: Our labels, int64 (T,).
    """

    world: str
    skills: tuple[str, ...]
    frames: npt.NDArray[np.uint8]
    truth: Labels
    predicted: Labels


class _Figure(Experiment):
    """Trains nothing: it shows the first test trajectory of our first network of each world."""

    sources = tuple(_SOURCES)

    def table(self, results: Sequence[ArmResult]) -> Table:
        """Returns the segments of each trajectory, with their frames as a picture."""
        of_worlds = [(world, Rows.of(results, world)) for world in _OURS]
        shown = [_shown(rows.arms[row][0]) for world, rows in of_worlds if (row := rows.chosen(_OURS[world]))]
        return Table(
            title="Skills found in held-out trajectories (Figure 2.3)",
            text="The first test trajectory of each world, and the labels of our network of seed 0: not decoded, not "
            "chosen for their looks.",
            sections=(Section(_HEADER, tuple(map(_cells, shown))),),
            claims=(),
            picture=Picture("Frames, predicted and true skills over time", partial(_picture, shown)),
        )


def _study(world: str) -> Study:
    (study,) = (each for source in _SOURCES.values() for each in source.studies if each.world == world)
    return study


def _shown(result: ArmResult) -> Shown:
    data = _study(result.world).data
    part = draw.Part(
        data.task,
        data.seed_of("test"),
        SPLITS.index("test"),
        data.test.least_skills,
        data.test.most_skills,
        first=0,
        stop=1,
    )
    (drawn,) = draw.demonstrations(part)
    labels: Any = result.shown[SHOWN_LABELS]
    predicted = np.array(labels[0])
    return Shown(result.world, data.world.skills, drawn["frames"], drawn["labels"], predicted)


def _cells(shown: Shown) -> tuple[str, ...]:
    accuracy = 100 * metrics.frame_accuracy(shown.predicted, shown.truth)
    return (
        shown.world,
        _segments(shown.predicted, shown.skills),
        _segments(shown.truth, shown.skills),
        f"{accuracy:.1f}",
    )


def _segments(labels: Labels, skills: Sequence[str]) -> str:
    return ", ".join(f"{skills[label]} [{start}, {end})" for start, end, label in _spans(labels))


def _spans(labels: Labels) -> list[tuple[int, int, int]]:
    starts = metrics.run_starts(labels).tolist()
    return [(start, end, int(labels[start])) for start, end in zip(starts, [*starts[1:], len(labels)], strict=True)]


def _picture(shown: Sequence[Shown]) -> bytes:
    figure = new_figure(_WIDTH_INCHES, 2 * _FRAME_INCHES * len(shown))
    for part, each in zip(figure.subfigures(len(shown), 1, squeeze=False)[:, 0], shown, strict=True):
        part.suptitle(each.world, x=0.01, ha="left", fontsize="small")
        grid = part.add_gridspec(2, _FRAMES, height_ratios=(3, 1))
        times = np.linspace(0, len(each.frames) - 1, _FRAMES).round().astype(int)
        for column, time in enumerate(times):
            axes = part.add_subplot(grid[0, column])
            axes.imshow(np.broadcast_to(each.frames[time], (*each.frames.shape[1:3], 3)))
            axes.set_axis_off()
            axes.set_title(each.skills[each.predicted[time]], fontsize="x-small")
        axes = part.add_subplot(grid[1, :])
        for row, labels in enumerate((each.predicted, each.truth)):
            for start, end, label in _spans(labels):
                axes.barh(row, end - start, left=start, color=f"C{label % 10}")
        axes.set_yticks([0, 1], ["predicted", "true"], fontsize="x-small")
        axes.set_xlim(0, len(each.truth))
        axes.set_xlabel("timestep", fontsize="x-small")
        axes.invert_yaxis()
    return png(figure)


EXPERIMENT = _Figure()
