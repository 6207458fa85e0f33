"""The segmentation service's learner on a dataset of the workbench."""

from pathlib import Path

import torch

from experiments.segmentation import dataset
from experiments.segmentation.dataset import DatasetSpec, SplitName
from freerein_segmentation.training import Demonstrations, SegmentationConfig, SegmentationLearner, network_spec


def make_learner(config: SegmentationConfig, spec: DatasetSpec, folder: Path) -> SegmentationLearner:
    """Returns the learner of frames, actions and tags of the dataset in a folder, on the CPU."""
    world = spec.world
    camera = world.cameras[0]
    frame = (camera.height, camera.width, camera.channels)
    return SegmentationLearner(
        config,
        network_spec(config, frame=frame, action=world.action, skills=world.skills),
        demonstrations(spec, folder, "train"),
        demonstrations(spec, folder, "validation"),
        fingerprint=spec.hash,
        device=torch.device("cpu"),
    )


def demonstrations(spec: DatasetSpec, folder: Path, name: SplitName) -> Demonstrations:
    """Returns a split as the segmentation service's learner reads it."""
    split = dataset.open_split(folder, spec, name)
    return Demonstrations(split.frames, split.actions, split.skills)
