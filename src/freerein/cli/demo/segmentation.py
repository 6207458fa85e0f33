"""Chapter 2 in the demo: from demonstrations tagged with their skills to a skill label for every timestep."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from freerein.cli.demo.context import HELD_OUT_SEED, Context
from freerein.cli.demo.pictures import LabelledTrajectory
from freerein.cli.demo.report import Figure
from freerein.clients import SegmentationClient
from freerein.data import Dataset
from freerein.data.truth import labels as true_labels
from freerein.metrics import majority_accuracy
from freerein.types.common import ModelRef
from freerein.types.learning import Fit
from freerein.types.segmentation import SegmentRequest
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


async def start_fit(context: Context, task: SegmentationTask) -> tuple[str, Fit]:
    """Starts to learn the skills from tags."""
    return await context.start_fit("segmentation", task.train_dataset, model_name=task.task, config=task.config)


async def label_held_out(context: Context, task: SegmentationTask) -> list[LabelledTrajectory]:
    """Labels the held-out trajectories."""
    context.reporter.command(f"freerein segment {task.held_out_dataset} --model {task.task} --smoothing 1 --index 0")
    root = context.dataset(task.held_out_dataset)
    dataset = Dataset(root)
    skills, labelled = dataset.spec.skills, []
    async with SegmentationClient(context.channel("segmentation")) as client:
        with context.reporter.progress(f"label {task.held_out_dataset}", len(dataset)) as advance:
            for index, trajectory in enumerate(dataset):
                (frames,) = trajectory.frames.values()
                request = SegmentRequest(ModelRef(task.task), frames, actions=trajectory.actions, smoothing=1.0)
                answer = await client.segment(request)
                labels = np.array([skills.index(skill) for skill in answer.skills], np.int64)[answer.labels]
                truth = true_labels(root, index)
                labelled.append(LabelledTrajectory(frames, truth, labels, answer.confidence, skills))
                advance(index + 1)
    return labelled


def median(trajectories: Sequence[LabelledTrajectory]) -> LabelledTrajectory:
    """Returns the trajectory of median accuracy."""
    return sorted(trajectories, key=lambda each: each.accuracy)[len(trajectories) // 2]


def figures(blocks: Sequence[LabelledTrajectory], grid: Sequence[LabelledTrajectory]) -> tuple[Figure, ...]:
    """Returns frame accuracy over all timesteps on `blocks` and on the grid.

    The baseline always answers a trajectory's longest true skill.
    """
    guess, majority = "each trajectory's longest skill", _majority_accuracy(blocks)
    return (
        Figure("segmentation.frame_accuracy", _accuracy(blocks), majority, guess, at_least=majority + 0.25),
        Figure("grid.frame_accuracy", _accuracy(grid), _majority_accuracy(grid), guess, at_least=0.99),
    )


def _accuracy(trajectories: Sequence[LabelledTrajectory]) -> float:
    return _mean_over_timesteps(trajectories, [each.accuracy for each in trajectories])


def _majority_accuracy(trajectories: Sequence[LabelledTrajectory]) -> float:
    return _mean_over_timesteps(trajectories, [majority_accuracy(each.truth) for each in trajectories])


def _mean_over_timesteps(trajectories: Sequence[LabelledTrajectory], values: Sequence[float]) -> float:
    return float(np.average(values, weights=[len(each.truth) for each in trajectories]))
