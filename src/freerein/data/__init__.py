"""Trajectory datasets on disk: LeRobotDataset v3, one parquet file per trajectory, crash-safe.

    <root>/data/           frames, actions, and per trajectory a goal text and the skills that occur
    <root>/meta/           LeRobot's index, rebuilt from data/ where the two differ
    <root>/cache/          decoded frames and actions, rebuilt when data/ changes
    <root>/labels/         per-timestep skills predicted by a segmentation model; see `freerein.data.labels`
    <root>/teachers.json   cards of the policies that acted, for distillation
    <root>/truth/          ground-truth labels for evaluation; only `freerein.data.truth` opens it

`create` and `open_writer` write, `Dataset` reads; `inspect`, `verify` and `check` report on a dataset.
"""

from freerein.data.cache import ActionCache, FrameCache, StepCache
from freerein.data.checks import DatasetSummary, Problem, check, inspect, verify
from freerein.data.layout import DatasetSpec, dataset_path, integer_fps
from freerein.data.meta import read_teachers, save_teachers
from freerein.data.reader import Dataset
from freerein.data.writer import Writer, create, open_writer

__all__ = [
    "ActionCache",
    "Dataset",
    "DatasetSpec",
    "DatasetSummary",
    "FrameCache",
    "Problem",
    "StepCache",
    "Writer",
    "check",
    "create",
    "dataset_path",
    "inspect",
    "integer_fps",
    "open_writer",
    "read_teachers",
    "save_teachers",
    "verify",
]
