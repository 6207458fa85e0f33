"""Chapter 2 in the demo: demonstrations and the skills that occur in them, in; a skill for every timestep, out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from freerein.cli.demo.context import HELD_OUT, Context
from freerein.cli.demo.fits import RunningFit, start_fit
from freerein.cli.demo.timeline import Labelled
from freerein.data import Dataset, truth
from freerein.metrics import random_cls_accuracy
from freerein.types.sim import DemonstrateRequest


@dataclass(frozen=True)
class Lesson:
    """What is to be learned in one world.

    Attributes:
        task: The task that is demonstrated; the model is named like it.
        train: Trajectories to learn from, tagged with the set of their skills.
        train_skills: Fewest and most different skills in each of them.
        held_out: Trajectories to label.
        held_out_skills: Different skills in each of these: more than in any that was learned from.
        config: The fit's configuration, where it is not the default.
    """

    task: str
    train: int
    train_skills: tuple[int, int]
    held_out: int
    held_out_skills: int
    config: Mapping[str, object]

    @property
    def train_name(self) -> str:
        """The dataset that is learned from."""
        return f"{self.task}-train"

    @property
    def held_out_name(self) -> str:
        """The dataset that is labelled."""
        return f"{self.task}-held-out"


GRID = Lesson("grid", 1000, (2, 4), 100, 5, {"steps": 300, "batch_size": 16})
BLOCKS = Lesson("blocks", 400, (2, 3), 60, 4, {"stride": 3})


@dataclass(frozen=True, eq=False)
class Labels:
    """What came of a lesson: its held-out trajectories, labelled."""

    labelled: tuple[Labelled, ...]

    @property
    def frame_accuracy(self) -> float:
        """The share of timesteps labelled right."""
        return _over_all_timesteps([(each.accuracy, len(each.truth)) for each in self.labelled])

    @property
    def random_cls_accuracy(self) -> float:
        """The share that a guess among the skills truly present gets right."""
        return _over_all_timesteps([(random_cls_accuracy(each.truth), len(each.truth)) for each in self.labelled])

    @property
    def median(self) -> Labelled:
        """The trajectory labelled neither best nor worst: the one that is drawn."""
        return sorted(self.labelled, key=lambda each: each.accuracy)[len(self.labelled) // 2]


async def record_lesson(context: Context, lesson: Lesson) -> None:
    """Records what is learned from, tags only, and what is held out, with labels to measure by."""
    fewest, most = lesson.train_skills
    more = lesson.held_out_skills
    train = DemonstrateRequest(
        lesson.task, "expert", min_skills=fewest, max_skills=most, count=lesson.train, seed=context.seed
    )
    held_out = DemonstrateRequest(
        lesson.task,
        "expert",
        min_skills=more,
        max_skills=more,
        count=lesson.held_out,
        seed=context.seed + HELD_OUT,
        privileged=True,
    )
    await context.record(lesson.train_name, train)
    await context.record(lesson.held_out_name, held_out)


async def start_lesson(context: Context, lesson: Lesson) -> RunningFit:
    """Starts to learn the skills from their tags."""
    return await start_fit(context, "segmentation", lesson.train_name, model_name=lesson.task, config=lesson.config)


async def label_held_out(context: Context, lesson: Lesson) -> Labels:
    """Labels the held-out trajectories of a lesson and joins the truth to them."""
    root = context.dataset(lesson.held_out_name)
    dataset = Dataset(root)
    labelled = []
    async with context.door("segmentation") as door:
        with context.screen.progress(f"label {lesson.held_out_name}", len(dataset)) as advance:
            for index, trajectory in enumerate(dataset):
                (frames,) = trajectory.frames.values()
                answer = await door.segment(lesson.task, frames, trajectory.actions)
                labels = _in_vocabulary_of(dataset.spec.skills, answer["labels"], answer["skills"])
                confidence = np.array(answer["confidence"], np.float32)
                labelled.append(Labelled(frames, truth.labels(root, index), labels, confidence, dataset.spec.skills))
                advance(index + 1)
    return Labels(tuple(labelled))


def _in_vocabulary_of(
    skills: tuple[str, ...], labels: Sequence[int], spoken: Sequence[str]
) -> "np.ndarray[tuple[int], np.dtype[np.int64]]":
    """Returns labels as indices into the dataset's skills, which is what its truth holds."""
    index = np.array([skills.index(skill) for skill in spoken], np.int64)
    return index[np.array(labels, np.int64)]


def _over_all_timesteps(parts: list[tuple[float, int]]) -> float:
    return sum(value * length for value, length in parts) / sum(length for _, length in parts)
