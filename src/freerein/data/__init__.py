"""Trajectory datasets on disk: LeRobotDataset v3, one parquet file per trajectory, crash-safe.

    <root>/data/           frames, actions, if any, terminations; per trajectory a goal text and the skills that occur
    <root>/meta/           LeRobot's index, rebuilt from data/ where the two differ
    <root>/cache/          decoded frames and actions, rebuilt when data/ changes
    <root>/labels/         per-timestep skills predicted by a segmentation model; see `freerein.data.labels`
    <root>/hand_labels/    labels that a person gave, for people; see `freerein.data.hand_labels`
    <root>/reached/        which frames show the goal, as a reward model judges; see `freerein.data.reached`
    <root>/tags.json       tags that were given after recording, instead of those in data/
    <root>/teachers.json   cards of the policies that acted, for distillation
    <root>/truth/          ground-truth labels for evaluation; only `freerein.data.truth` opens it

`create` and `open_writer` write, `Dataset` reads; `inspect`, `verify` and `check` report on a dataset; `tag` and
`label` bring annotations that people made; `import_trajectories` brings datasets of other tools. `delete` and `prune`
make room.
"""

from freerein.data.action_table import read_actions as read_actions
from freerein.data.action_table import read_choices as read_choices
from freerein.data.annotations import label as label
from freerein.data.annotations import tag as tag
from freerein.data.cache import StepCache as StepCache
from freerein.data.checks import DatasetSummary as DatasetSummary
from freerein.data.checks import FitPrediction as FitPrediction
from freerein.data.checks import check as check
from freerein.data.checks import inspect as inspect
from freerein.data.checks import predict_fit as predict_fit
from freerein.data.checks import verify as verify
from freerein.data.folders import FolderSource as FolderSource
from freerein.data.folders import ImageSource as ImageSource
from freerein.data.importing import Source as Source
from freerein.data.importing import import_trajectories as import_trajectories
from freerein.data.importing import imported as imported
from freerein.data.label_table import LabelOptions as LabelOptions
from freerein.data.label_table import TimeUnit as TimeUnit
from freerein.data.layout import DatasetSpec as DatasetSpec
from freerein.data.layout import dataset_path as dataset_path
from freerein.data.layout import integer_fps as integer_fps
from freerein.data.lerobot_features import LeRobotOptions as LeRobotOptions
from freerein.data.lerobot_source import LeRobotSource as LeRobotSource
from freerein.data.meta import read_teachers as read_teachers
from freerein.data.meta import save_teachers as save_teachers
from freerein.data.mime import MimeSource as MimeSource
from freerein.data.reader import Dataset as Dataset
from freerein.data.removal import delete as delete
from freerein.data.removal import prune as prune
from freerein.data.tag_checks import Problem as Problem
from freerein.data.tag_checks import tag_problems as tag_problems
from freerein.data.timestep_texts import TextKind as TextKind
from freerein.data.writer import Writer as Writer
from freerein.data.writer import create as create
from freerein.data.writer import open_writer as open_writer
