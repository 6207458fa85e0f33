"""Demonstrations of a world in raw files, drawn once and found by their spec and the world's version.

    <work>/datasets/<hash>/<split>/frames.raw actions.raw lengths.raw tags.raw
                           truth/<split>/labels.raw                              read by `truth.py` alone

`split` is train, validation or test. See `cache_paths` for the hash.
"""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from experiments.segmentation import draw
from experiments.workbench.arms import world_version
from experiments.workbench.cache_paths import cache_path
from experiments.workbench.locks import locked
from freerein.data.cache import D, StepCache
from freerein.errors import FailedPrecondition
from freerein.learning.trajectories import Trajectories
from freerein_sim.worlds.tasks import tasks
from freerein_sim.worlds.world import WorldSpec

SplitName = Literal["train", "validation", "test"]
SPLITS: tuple[SplitName, ...] = get_args(SplitName)
"""Splits in the order in which they are drawn."""

_LEAST_PER_PROCESS = 64
"""Trajectories that are worth a process."""


@dataclass(frozen=True)
class SplitSpec:
    """Number of trajectories of a split, and of different skills in each, drawn uniformly in [least, most]."""

    count: int
    least_skills: int
    most_skills: int


@dataclass(frozen=True)
class DatasetSpec:
    """The source of a dataset.

    Attributes:
        task: Task of the sim service.
        train: Trajectories that networks are trained on.
        validation: Trajectories that choose weights and learning rates.
        test: Trajectories that are evaluated once.
        seed: Seed of every random draw.
        test_seed: Seed of the test trajectories alone, where it is another.
    """

    task: str
    train: SplitSpec
    validation: SplitSpec
    test: SplitSpec
    seed: int = 0
    test_seed: int | None = None

    @property
    def world(self) -> WorldSpec:
        """The world's spec."""
        return tasks()[self.task].spec

    def split(self, name: SplitName) -> SplitSpec:
        """Returns the spec of a split."""
        return {"train": self.train, "validation": self.validation, "test": self.test}[name]

    def seed_of(self, name: SplitName) -> int:
        """Returns the seed that a split is drawn from."""
        return self.seed if name != "test" or self.test_seed is None else self.test_seed


def folder_of(spec: DatasetSpec, work: Path) -> Path:
    """Returns the folder of a dataset, which may not have been drawn yet."""
    return cache_path(work / "datasets", {"spec": spec, "world_version": world_version(spec.task)})


def open_or_draw(spec: DatasetSpec, work: Path) -> Path:
    """Returns the folder of a dataset; draws it first, in parallel processes, where it does not exist."""
    folder = folder_of(spec, work)
    with locked(folder.with_suffix(".lock")):
        if not folder.is_dir():
            unfinished = folder.with_suffix(".unfinished")
            shutil.rmtree(unfinished, ignore_errors=True)
            for name in SPLITS:
                _draw_split(spec, name, unfinished)
            unfinished.replace(folder)
    return folder


def open_split(folder: Path, spec: DatasetSpec, name: SplitName, *, sees_frames: bool = True) -> Trajectories:
    """Returns what learners may see of a split: frames, or black ones, actions and tags, mapped from disk."""
    world = spec.world
    camera, action = world.cameras[0], world.action
    lengths = np.fromfile(folder / name / "lengths.raw", np.int64)  # (n,)
    tags = np.fromfile(folder / name / "tags.raw", np.bool_).reshape(len(lengths), -1)  # (n, K)
    frame_shape = (camera.height, camera.width, camera.channels)
    action_dtype: np.dtype[Any] = np.dtype(np.int64 if action.choices else np.float32)
    frames = step_cache(folder / name / "frames.raw", lengths, np.dtype(np.uint8), frame_shape)
    if not sees_frames:
        frames = StepCache(np.broadcast_to(np.uint8(0), (int(lengths.sum()), *frame_shape)), frames.offsets)
    return Trajectories(
        {camera.name: frames},
        step_cache(folder / name / "actions.raw", lengths, action_dtype, (action.size,)),
        skills=[tuple(world.skills[index] for index in np.flatnonzero(row)) for row in tags],
    )


def step_cache(path: Path, lengths: npt.NDArray[np.int64], dtype: np.dtype[D], shape: tuple[int, ...]) -> StepCache[D]:
    """Returns the timesteps in a raw file, by trajectory; `shape` is that of one timestep."""
    offsets = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
    return StepCache(np.memmap(path, dtype, mode="r", shape=(int(offsets[-1]), *shape)), offsets)


def _draw_split(spec: DatasetSpec, name: SplitName, folder: Path) -> None:
    """Draws the parts of a split at the same time, and joins their files."""
    split = spec.split(name)
    count = max(1, min(os.cpu_count() or 1, split.count // _LEAST_PER_PROCESS))
    bounds = np.linspace(0, split.count, count + 1).astype(int).tolist()
    parts = {
        folder / "parts" / f"{name}-{first}": draw.Part(
            spec.task, spec.seed_of(name), SPLITS.index(name), split.least_skills, split.most_skills, first, stop
        )
        for first, stop in pairwise(bounds)
    }
    _draw_parts(parts)
    for file in draw.FILES:
        target = folder / ("truth" if file == "labels" else "") / name / f"{file}.raw"
        target.parent.mkdir(parents=True, exist_ok=True)
        with target.open("wb") as joined:
            for path in parts:
                with (path / file).open("rb") as piece:
                    shutil.copyfileobj(piece, joined)
    shutil.rmtree(folder / "parts")


def _draw_parts(parts: Mapping[Path, draw.Part]) -> None:
    """Draws several parts in a process each, a single one in this process."""
    if len(parts) == 1:
        draw.main(*next(iter(parts.items())))
        return
    commands = (
        [sys.executable, "-m", "experiments.segmentation.draw", str(path), json.dumps(asdict(part))]
        for path, part in parts.items()
    )
    with ExitStack() as opened:
        processes = [opened.enter_context(subprocess.Popen(command, stdin=subprocess.PIPE)) for command in commands]
        exit_codes = [process.wait() for process in processes]
    if any(exit_codes):
        raise FailedPrecondition("Drawing the demonstrations failed.", hint="See the error of its process above.")
