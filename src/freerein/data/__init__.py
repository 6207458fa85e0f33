"""Trajectory datasets on disk: LeRobotDataset v3, one parquet file per trajectory, safe against crashes.

    <root>/data/      what learners see: frames, actions, and per trajectory a goal text and the skills that occur
    <root>/meta/      LeRobot's index, rebuilt from data/ whenever the two differ
    <root>/cache/     decoded frames to train from, rebuilt when data/ changed
    <root>/labels/    a skill per timestep as a segmentation model predicted it, for skill policies to learn from
    <root>/teachers.json   what is told of the policies that acted, where policies did; see `freerein.data.teachers`
    <root>/truth/     ground-truth labels for evaluation; only `freerein.data.truth` opens it

`create` and `open_writer` write, `Dataset` reads, `inspect`, `verify` and `check` judge.
"""

from freerein.data.cache import ActionCache, FrameCache, StepCache
from freerein.data.fitness import check
from freerein.data.inspection import Summary, inspect
from freerein.data.integrity import Problem, verify
from freerein.data.layout import dataset_path
from freerein.data.reader import Dataset
from freerein.data.spec import DatasetSpec, integer_fps
from freerein.data.writer import Writer, create, open_writer

__all__ = [
    "ActionCache",
    "Dataset",
    "DatasetSpec",
    "FrameCache",
    "Problem",
    "StepCache",
    "Summary",
    "Writer",
    "check",
    "create",
    "dataset_path",
    "inspect",
    "integer_fps",
    "open_writer",
    "verify",
]
