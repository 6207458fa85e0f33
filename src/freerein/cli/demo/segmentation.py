"""Chapter 2 in the demo: from demonstrations tagged with their skills to a skill label for every timestep."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from freerein.cli.demo.context import HELD_OUT_SEED, Context, RunningFit
from freerein.cli.demo.pictures import LabelledTrajectory
from freerein.cli.demo.report import Figure
from freerein.data import Dataset, truth
from freerein.metrics import majority_accuracy, random_cls_accuracy
from freerein.types.sim import DemonstrateRequest


@dataclass(frozen=True)
class SegmentationTask:
    """Data and configuration of one segmentation model.

    Attributes:
        task: Task that is demonstrated; also the model's name.
        train: Number of training trajectories, tagged with the set of their skills.
        train_skills: Fewest and most different skills in each training trajectory.
        held_out: Number of held-out trajectories.
        held_out_skills: Different skills in each held-out trajectory: more than in any training trajectory.
        config: Configuration of the fit.
    """

    task: str
    train: int
    train_skills: tuple[int, int]
    held_out: int
    held_out_skills: int
    config: Mapping[str, object]

    @property
    def train_dataset(self) -> str:
        """Name of the training dataset."""
        return f"{self.task}-train"

    @property
    def held_out_dataset(self) -> str:
        """Name of the held-out dataset."""
        return f"{self.task}-held-out"


GRID = SegmentationTask("grid", 1000, (2, 4), 100, 5, {"steps": 300, "batch_size": 16})
BLOCKS = SegmentationTask("blocks", 400, (2, 3), 60, 4, {"stride": 3})


@dataclass(frozen=True, eq=False)
class SegmentationResult:
    """The labelled held-out trajectories of a task."""

    trajectories: tuple[LabelledTrajectory, ...]

    @property
    def frame_accuracy(self) -> float:
        """Frame accuracy over all timesteps."""
        return self._mean_over_timesteps(lambda each: each.accuracy)

    @property
    def majority_accuracy(self) -> float:
        """Accuracy of a guesser who is told each trajectory's longest skill and always answers it."""
        return self._mean_over_timesteps(lambda each: majority_accuracy(each.truth))

    @property
    def random_cls_accuracy(self) -> float:
        """Accuracy of a uniform guess among the skills that occur in the trajectory (Random-Cls)."""
        return self._mean_over_timesteps(lambda each: random_cls_accuracy(each.truth))

    @property
    def median(self) -> LabelledTrajectory:
        """The trajectory of median accuracy."""
        return sorted(self.trajectories, key=lambda each: each.accuracy)[len(self.trajectories) // 2]

    def _mean_over_timesteps(self, value: Callable[[LabelledTrajectory], float]) -> float:
        lengths = [len(each.truth) for each in self.trajectories]
        return float(np.average([value(each) for each in self.trajectories], weights=lengths))


async def record(context: Context, task: SegmentationTask) -> None:
    """Records the training dataset, with tags only, and the held-out dataset, with true labels."""
    fewest, most = task.train_skills
    more = task.held_out_skills
    train = DemonstrateRequest(
        task.task, "expert", min_skills=fewest, max_skills=most, count=task.train, seed=context.seed
    )
    held_out = DemonstrateRequest(
        task.task,
        "expert",
        min_skills=more,
        max_skills=more,
        count=task.held_out,
        seed=context.seed + HELD_OUT_SEED,
        privileged=True,
    )
    await context.record(task.train_dataset, train)
    await context.record(task.held_out_dataset, held_out)


async def start_fit(context: Context, task: SegmentationTask) -> RunningFit:
    """Starts to learn the skills from tags."""
    return await context.start_fit("segmentation", task.train_dataset, model_name=task.task, config=task.config)


async def label_held_out(context: Context, task: SegmentationTask) -> SegmentationResult:
    """Labels the held-out trajectories."""
    root = context.dataset(task.held_out_dataset)
    dataset = Dataset(root)
    skills, labelled = dataset.spec.skills, []
    async with context.rest("segmentation") as client:
        with context.reporter.progress(f"label {task.held_out_dataset}", len(dataset)) as advance:
            for index, trajectory in enumerate(dataset):
                (frames,) = trajectory.frames.values()
                answer = await client.segment(task.task, frames, trajectory.actions)
                vocabulary = np.array([skills.index(skill) for skill in answer["skills"]], np.int64)
                labels = vocabulary[np.array(answer["labels"], np.int64)]
                confidence = np.array(answer["confidence"], np.float32)
                labelled.append(LabelledTrajectory(frames, truth.labels(root, index), labels, confidence, skills))
                advance(index + 1)
    return SegmentationResult(tuple(labelled))


def figures(blocks: SegmentationResult, grid: SegmentationResult) -> tuple[Figure, ...]:
    """Returns the figures of both tasks."""
    guess = "each trajectory's longest skill"
    return (
        Figure(
            "segmentation.frame_accuracy",
            "blocks: timesteps labelled right, four skills where training saw two or three",
            blocks.frame_accuracy,
            blocks.majority_accuracy,
            guess,
            at_least=blocks.majority_accuracy + 0.25,
        ),
        Figure("segmentation.random_cls_accuracy", "blocks: Random-Cls", blocks.random_cls_accuracy),
        Figure(
            "grid.frame_accuracy",
            "grid: timesteps labelled right, five skills where training saw two to four",
            grid.frame_accuracy,
            grid.majority_accuracy,
            guess,
            at_least=0.99,
        ),
        Figure("grid.random_cls_accuracy", "grid: Random-Cls", grid.random_cls_accuracy),
    )
