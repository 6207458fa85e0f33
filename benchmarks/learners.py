"""The shipped learners at their default configuration, on synthetic data of the sizes of their worlds.

Skill k shows a bright square at place k of a noisy frame and executes action k, so that a training loss can fall.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from freerein.data.cache import open_or_build
from freerein.learning.fit import Learner
from freerein.learning.trajectories import Trajectories, TrajectoryArrays
from freerein.serving.model_store import CLONE_MODELS, ModelStore
from freerein.types.common import ActionSpec, Camera, ModelRef
from freerein_imitation.model.goal_conditioned import GoalConditionedNetwork
from freerein_imitation.training.goal_conditioned import GoalConditionedConfig, policy_losses
from freerein_imitation.training.goal_conditioned import network_spec as goal_conditioned_spec
from freerein_imitation.training.goal_images import GoalImagesLearner
from freerein_imitation.training.skills import SkillsConfig, SkillsLearner
from freerein_imitation.training.skills import network_spec as skills_spec
from freerein_reward.model import load_grounding
from freerein_reward.training import RewardConfig, RewardModelLearner
from freerein_reward.training import network_spec as reward_spec
from freerein_reward.training.caption_dataset import CaptionDataset, pairwise_relations
from freerein_segmentation.training import SegmentationConfig, SegmentationLearner
from freerein_segmentation.training import network_spec as segmentation_spec

_SKILLS = ("reach", "grasp", "lift", "place", "retreat")
_ACTION = ActionSpec(len(_SKILLS), 0, _SKILLS, "m", (0.05,) * len(_SKILLS))
_TRAJECTORIES, _SEGMENTS = 64, 3
_IMAGES, _BLOCK, _NOISE = 2000, 8, 60
_PHRASES = ("a red block", "a green block", "a yellow block", "a blue block")
_COLOURS = np.array([(220, 40, 40), (40, 200, 60), (220, 210, 50), (50, 80, 220)], np.uint8)
_CPU = torch.device("cpu")


@dataclass(frozen=True)
class World:
    """Sizes of a world's demonstrations.

    Attributes:
        frame: Height, width and channels.
        timesteps: Fewest and most timesteps of a trajectory.
    """

    frame: tuple[int, int, int]
    timesteps: tuple[int, int]

    @property
    def camera(self) -> Camera:
        """The only camera."""
        return Camera("front", *self.frame)


_GRID, _BLOCKS = World((33, 30, 3), (10, 40)), World((64, 64, 3), (90, 130))
_GRAY, _LARGE = World((112, 112, 1), (60, 100)), World((128, 128, 3), (60, 100))


@dataclass(frozen=True)
class Variant:
    """What differs from how a learner is shipped.

    Attributes:
        batch_factor: Factor of the batch size.
        in_memory: Whether frames are arrays in memory; by default they are views of a mapped file.
    """

    batch_factor: int = 1
    in_memory: bool = False


def names() -> tuple[str, ...]:
    """Returns the names of all learners."""
    return tuple(_LEARNERS)


def build(name: str, variant: Variant, folder: Path) -> Learner[Any]:
    """Returns a learner; `folder` holds the files of its frames."""
    return _LEARNERS[name](variant, folder)


def _segmentation(variant: Variant, folder: Path, *, world: World) -> SegmentationLearner:
    config = SegmentationConfig(batch_size=SegmentationConfig().batch_size * variant.batch_factor)
    demonstrations, _ = _draw(world, variant, folder)
    training, validation = demonstrations.split(fraction=config.validation_fraction, seed=config.seed)
    spec = segmentation_spec(config, cameras=(world.camera,), action=_ACTION, skills=_SKILLS)
    return SegmentationLearner(config, spec, training, validation, "", _CPU)


def _goal_conditioned(variant: Variant, folder: Path, *, world: World) -> Learner[Any]:
    config = GoalConditionedConfig(batch_size=GoalConditionedConfig().batch_size * variant.batch_factor)
    exploration, _ = _draw(world, variant, folder)
    training, validation = exploration.split(fraction=config.validation_fraction, seed=config.seed)
    spec = goal_conditioned_spec(config, cameras=(world.camera,), action=_ACTION)
    losses = partial(policy_losses, consistency_weight=config.forward_consistency_weight)
    return GoalImagesLearner(config, partial(GoalConditionedNetwork, spec), losses, training, validation, "", _CPU)


def _skills(variant: Variant, folder: Path, *, world: World) -> SkillsLearner:
    config = SkillsConfig(batch_size=SkillsConfig().batch_size * variant.batch_factor)
    demonstrations, labels = _draw(world, variant, folder)
    spec = skills_spec(config, cameras=(world.camera,), action=_ACTION, skills=_SKILLS)
    return SkillsLearner.prepare(config, spec, demonstrations, labels, fingerprint="", device=_CPU)


def _reward(variant: Variant, _: Path) -> RewardModelLearner:
    store = ModelStore(CLONE_MODELS / "reward")
    folder = store.folder(ModelRef("grounding", store.active_version("grounding")))
    grounding = load_grounding(folder, "cpu")
    batch_size = RewardConfig().batch_size * variant.batch_factor
    config = RewardConfig(cameras=("front",), phrases=_PHRASES, batch_size=batch_size)
    images = _draw_captions(config, size=grounding.network.spec.image_size)
    training, validation = images.split(
        np.ones(_IMAGES, np.int64), fraction=config.validation_fraction, seed=config.seed
    )
    return RewardModelLearner(
        config=config,
        spec=reward_spec(grounding.network.spec, config),
        training=training,
        validation=validation,
        grounding=grounding,
        grounding_version=folder.name,
        fingerprint="",
        device=_CPU,
    )


_LEARNERS: Mapping[str, Callable[[Variant, Path], Learner[Any]]] = {
    "segmentation_33x30x3": partial(_segmentation, world=_GRID),
    "segmentation_64x64x3": partial(_segmentation, world=_BLOCKS),
    "segmentation_112x112x1": partial(_segmentation, world=_GRAY),
    "goal_conditioned_64x64x3": partial(_goal_conditioned, world=_BLOCKS),
    "skills_64x64x3": partial(_skills, world=_BLOCKS),
    "reward_64x64x3": _reward,
    "segmentation_128x128x3": partial(_segmentation, world=_LARGE),
}


def _draw(world: World, variant: Variant, folder: Path) -> tuple[Trajectories, list[npt.NDArray[np.int64]]]:
    """Returns trajectories of three skills each, and the skill at each timestep, int64 (T,)."""
    rng = np.random.default_rng(0)
    labels = [_draw_labels(world, rng) for _ in range(_TRAJECTORIES)]
    drawn = [_draw_frames(world, each, rng) for each in labels]
    frames: TrajectoryArrays[np.uint8] = drawn
    if not variant.in_memory:
        path = folder / "cache" / "x".join(map(str, world.frame)) / "frames.raw"
        lengths = np.array([len(each) for each in labels], np.int64)
        frames = open_or_build(path, dtype=np.dtype(np.uint8), shape=world.frame, lengths=lengths, parts=drawn)
    codes = np.eye(len(_SKILLS), dtype=np.float32)
    tags = [tuple(_SKILLS[skill] for skill in np.unique(each)) for each in labels]
    return Trajectories({world.camera.name: frames}, [codes[each] for each in labels], tags), labels


def _draw_labels(world: World, rng: np.random.Generator) -> npt.NDArray[np.int64]:
    """Returns the skill at each timestep, int64 (T,)."""
    length = int(rng.integers(*world.timesteps, endpoint=True))
    skills = rng.choice(len(_SKILLS), _SEGMENTS, replace=False)
    return np.repeat(skills, -(-length // _SEGMENTS))[:length]


def _draw_frames(world: World, labels: npt.NDArray[np.int64], rng: np.random.Generator) -> npt.NDArray[np.uint8]:
    """Returns noise with a bright square at a place that depends on the skill, uint8 (T, H, W, C)."""
    frames = rng.integers(_NOISE, size=(len(labels), *world.frame), dtype=np.uint8)
    height, width = world.frame[0] // len(_SKILLS), world.frame[1] // len(_SKILLS)
    for image, skill in zip(frames, labels, strict=True):
        image[skill * height : (skill + 1) * height, skill * width : (skill + 1) * width] = 255
    return frames


def _draw_captions(config: RewardConfig, *, size: int) -> CaptionDataset:
    """Returns images of one square per phrase at random places, with their true relations."""
    rng = np.random.default_rng(0)
    frames = rng.integers(_NOISE, size=(_IMAGES, size, size, 3), dtype=np.uint8)
    corners = rng.integers(size - _BLOCK, size=(_IMAGES, len(_COLOURS), 2))  # (N, P, 2)
    for image, places in zip(frames, corners, strict=True):
        for colour, (row, column) in zip(_COLOURS, places, strict=True):
            image[row : row + _BLOCK, column : column + _BLOCK] = colour
    y, x = corners[:, :, 0] / size, corners[:, :, 1] / size
    relations = pairwise_relations(x, y, np.ones(x.shape, bool), epsilon=config.epsilon)
    return CaptionDataset((frames,), config.phrases, relations, np.ones(len(_COLOURS)))
