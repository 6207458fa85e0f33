"""The segmentation service's learner on a dataset of the workbench."""

from pathlib import Path

from experiments.segmentation.dataset import DatasetSpec, open_split
from freerein.learning.inputs import spec_of
from freerein.learning.model_files import choose_device
from freerein_segmentation.model import ModelSpec
from freerein_segmentation.training import SegmentationConfig, SegmentationLearner


def make_learner(
    config: SegmentationConfig, spec: DatasetSpec, folder: Path, *, sees_frames: bool = True
) -> SegmentationLearner:
    """Returns the learner of frames, actions and tags of the dataset in a folder, on a CUDA device if any."""
    world = spec.world
    return SegmentationLearner(
        config,
        spec_of(
            config, ModelSpec, cameras=world.cameras[:1], action=world.action, skills=world.skills, scores_colours=True
        ),
        open_split(folder, spec, "train", sees_frames=sees_frames),
        open_split(folder, spec, "validation", sees_frames=sees_frames),
        fingerprint=folder.name,
        device=choose_device("auto"),
    )
