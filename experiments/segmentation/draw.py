"""Draws demonstrations from a world's generator: `python -m experiments.segmentation.draw FOLDER PART`.

PART is a `Part` as JSON; FOLDER receives its raw files, named as in `FILES`. The process ends with its parent.
"""

import json
import sys
from collections.abc import Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from freerein.jobs.child import die_with_parent
from freerein_sim.worlds.episodes import RecordedEpisode, record_episode
from freerein_sim.worlds.tasks import tasks
from freerein_sim.worlds.world import TaskDefinition, World, expert_of

FILES = ("frames", "actions", "lengths", "tags", "labels")
"""frames uint8 (N, H, W, C); actions float32 (N, A) or int64 (N, 1); lengths int64 (n,), with sum N; tags bool (n, K);
labels int64 (N,), which are ground truth."""


@dataclass(frozen=True)
class Part:
    """Some trajectories of a split; a trajectory does not depend on the part that it is drawn in.

    Attributes:
        task: Task of the sim service.
        seed: Seed of the dataset.
        stream: Number of the split.
        least_skills: Least number of different skills in a trajectory.
        most_skills: Greatest number.
        first: Index of the first trajectory in its split.
        stop: Index after the last one.
    """

    task: str
    seed: int
    stream: int
    least_skills: int
    most_skills: int
    first: int
    stop: int


def main(folder: Path, part: Part) -> None:
    """Writes the files of a part."""
    folder.mkdir(parents=True, exist_ok=True)
    with ExitStack() as opened:
        files = {name: opened.enter_context((folder / name).open("wb")) for name in FILES}
        for arrays in demonstrations(part):
            for name, file in files.items():
                file.write(arrays[name].tobytes())


def demonstrations(part: Part) -> Iterator[dict[str, npt.NDArray[Any]]]:
    """Yields the arrays of each trajectory of a part."""
    task = tasks()[part.task]
    with closing(task.make()) as world:
        for index in range(part.first, part.stop):
            rng = np.random.default_rng([part.seed, part.stream, index])
            count = int(rng.integers(part.least_skills, part.most_skills + 1))
            yield _demonstration(task, world, count, rng)


def _demonstration(
    task: TaskDefinition, world: World, skill_count: int, rng: np.random.Generator
) -> dict[str, npt.NDArray[Any]]:
    """Returns a successful demonstration of one of the task's recipes with `skill_count` skills."""
    skills, camera = task.spec.skills, task.spec.cameras[0]
    while True:
        recipe = task.recipes.draw(rng, skills, fewest=skill_count, most=skill_count)
        world.reset(rng, recipe=recipe)
        episode = record_episode(
            world, expert_of(world)(recipe, rng), cameras=(camera,), max_steps=task.spec.max_episode_steps
        )
        if episode.success:
            return _arrays(episode, tags=[skill in recipe for skill in skills])


def _arrays(episode: RecordedEpisode, tags: list[bool]) -> dict[str, npt.NDArray[Any]]:
    (frames,) = episode.frames.values()
    arrays = (frames, episode.actions, np.array([len(frames)]), np.array(tags), episode.labels)
    return dict(zip(FILES, arrays, strict=True))


if __name__ == "__main__":
    die_with_parent()
    main(Path(sys.argv[1]), Part(**json.loads(sys.argv[2])))
