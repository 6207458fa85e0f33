"""Captions of a dataset's images, told from pixels by the grounding model: once per fit, before it begins."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from freerein.atomic_files import write_atomic
from freerein.data import Dataset
from freerein.learning import tensor_files
from freerein_reward.model import GroundingModel, Preprocess
from freerein_reward.training.config import RewardConfig
from freerein_reward.training.described import Described, relations_of, sides_of

_IMAGES_AT_ONCE = 256


def describe(
    dataset: Dataset,
    finder: GroundingModel,
    config: RewardConfig,
    path: Path,
    *,
    on_share: Callable[[float], None] = lambda _: None,
) -> Described:
    """Returns a dataset's images with captions for each ordered pair of phrases that they show.

    Args:
        dataset: Where the images are.
        finder: Tells where things are.
        config: Names the cameras, of which the first is told from, the phrases, and what counts as near and as shown.
        path: Where captions are kept; those of a fit that goes on are there already.
        on_share: Told how much is done, in [0, 1], again and again.
    """
    preprocess = Preprocess(finder.network.spec.side)
    views = tuple(_resized(dataset.cached_frames(camera).steps, preprocess) for camera in config.cameras)
    if path.is_file():
        told = tensor_files.parse(path.read_bytes())
        relations, sides = told["relations"].numpy(), told["sides"].numpy()
    else:
        relations, sides = _told(views[0], finder, config, on_share)
        told = {"relations": torch.from_numpy(relations), "sides": torch.from_numpy(sides)}
        write_atomic(path, tensor_files.dump(told))
    return Described(views, config.phrases, relations, sides)


def _told(
    frames: npt.NDArray[np.uint8], finder: GroundingModel, config: RewardConfig, on_share: Callable[[float], None]
) -> tuple[npt.NDArray[np.int8], npt.NDArray[np.int8]]:
    """Returns relations and sides, int8 (N, P, P) each, of frames (N, side, side, 3)."""
    relations, sides = [], []
    for start in range(0, len(frames), _IMAGES_AT_ONCE):
        found = finder.ground(frames[start : start + _IMAGES_AT_ONCE], config.phrases)
        relations.append(relations_of(found.x, found.y, found.presence >= config.presence, epsilon=config.epsilon))
        sides.append(sides_of(found.x, relations[-1]))
        on_share(min(1.0, (start + _IMAGES_AT_ONCE) / len(frames)))
    return np.concatenate(relations), np.concatenate(sides)


def _resized(frames: npt.NDArray[np.uint8], preprocess: Preprocess) -> npt.NDArray[np.uint8]:
    """Returns frames (N, H, W, C) as uint8 (N, side, side, 3); the same array where they are that already."""
    if frames.shape[1:] == (preprocess.side, preprocess.side, 3):
        return frames
    return np.stack([preprocess(frame) for frame in frames])
