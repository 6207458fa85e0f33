"""A student's rollouts with another eye: one that has never seen the colour of the test tasks.

It is that of a reward model that is fitted from scratch, by distillation of the grounding model's keypoints, to images
in which nothing has the colour, and no hue is turned. All that it learns of that colour's phrase is that it is absent.
How the eye finds the gripper is not changed.

<folder>/data/datasets/rollouts/       the student's rollouts, as hard links
                                eye/   the eye
"""

import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import ClassVar

import numpy as np

from experiments.chapter4.students import DATASET
from experiments.chapter4.tasks import TEST_COLOUR
from experiments.chapter4.unseen_colour import blue_pixels
from experiments.robustness import reward_model
from experiments.robustness.draw import Drawn, Exploration
from experiments.robustness.worlds import SCATTERED
from experiments.workbench.configs import Config
from freerein.data import dataset_path
from freerein.learning import model_files
from freerein.learning.actor_critic.shared_object_encoder import FOLDER, load_object_encoder
from freerein_reward.methods.relation_captions.config import RewardConfig
from freerein_reward.model import DualEncoderModel

_PIECE, _DISTILLATION = 100, 10.0


@dataclass(frozen=True)
class ColourlessExploration:
    """Trajectories of `Exploration` of which no frame shows the colour, from pieces with successive seeds."""

    count: int
    seed: int
    task: ClassVar[str] = SCATTERED

    def draw(self) -> Drawn:
        """Draws the trajectories."""
        kept: list[np.ndarray] = []
        for seed in count(self.seed):
            kept += [
                frames for frames in Exploration(_PIECE, seed).draw().by_trajectory("frames") if not blue_pixels(frames)
            ]
            if len(kept) >= self.count:
                break
        del kept[self.count :]
        return Drawn({"lengths": np.array([len(each) for each in kept]), "frames": np.concatenate(kept)}, {})


_IMAGES = ColourlessExploration(count=1000, seed=3000)
"""As many as the reward model has that the teachers' eye is of."""


_ABSENT = tuple(phrase for phrase in reward_model.PHRASES if TEST_COLOUR in phrase)


def eye_config(seed: int) -> Config:
    """Returns everything that the eye depends on."""
    grounding = reward_model.grounding_version()
    return {"fit": _fit(seed), "training": _IMAGES, "grounding": grounding, "absent": list(_ABSENT)}


def with_eye(student: Path, folder: Path, work: Path, on_progress: Callable[[], None], *, seed: int) -> Path | None:
    """Returns a folder that holds a student's rollouts with the eye; None when SIGTERM stopped the eye's fit.

    Args:
        student: The student's folder.
        folder: Is made unless it is there.
        work: Folder that all arms share.
        on_progress: Called now and then.
        seed: Of the eye's fit.
    """
    rollouts, copied = (dataset_path(each / "data", DATASET) for each in (student, folder))
    if not copied.is_dir():
        model = reward_model.fit_model(_fit(seed), work, on_progress, training=_IMAGES, absent=_ABSENT)
        if model is None:
            return None
        part = copied.with_name(f".{DATASET}.part")
        shutil.rmtree(part, ignore_errors=True)
        shutil.copytree(rollouts, part, copy_function=os.link, ignore=shutil.ignore_patterns(FOLDER))
        _save_eye(model, rollouts / FOLDER, part / FOLDER)
        part.rename(copied)
    return folder


def _save_eye(model: DualEncoderModel, original: Path, folder: Path) -> None:
    encoder, card = load_object_encoder(original)
    encoder.eye.load_objects(model.network.image.state_dict())
    folder.mkdir()
    model_files.save_model(encoder, folder, card={"model": {"name": "without-colour"}, "camera": card["camera"]})


def _fit(seed: int) -> RewardConfig:
    config = reward_model.fit_config(augmentation=0.0, seed=seed)
    return replace(config, initial="scratch", distillation=_DISTILLATION)
