"""Reward models of the scattered blocks: a fit to captions of random exploration, by the grounding model."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import safetensors.numpy
import torch

from experiments.robustness.draw import Drawn, Exploration, Spec, dataset_path, open_or_draw
from experiments.robustness.fits import fit_once
from experiments.robustness.worlds import CAMERA
from experiments.workbench.locks import locked
from freerein.atomic_files import write_atomic
from freerein.errors import FailedPrecondition
from freerein_reward.methods.relation_captions.caption_dataset import (
    CaptionDataset,
    image_relations,
    place_keypoints,
)
from freerein_reward.methods.relation_captions.config import RewardConfig
from freerein_reward.methods.relation_captions.losses import RewardModelLearner, network_spec
from freerein_reward.model import DualEncoderModel, GradCamModel, load_built_in, load_reward_model

COLOURS = ("red", "green", "yellow", "blue")
PHRASES = tuple(f"a {colour} block" for colour in COLOURS)
EPSILON = 0.105
"""Width of a block's front in the frames, as a share of theirs."""

TRAINING = Exploration(count=1500, seed=2)
_GROUNDING = Path("models/reward/grounding")


def fit_config(*, augmentation: float, seed: int) -> RewardConfig:
    """Returns the service's configuration of a fit."""
    given = {"phrases": list(PHRASES), "cameras": [CAMERA], "epsilon": EPSILON}
    return RewardConfig.from_mapping({**given, "augmentation": augmentation, "seed": seed})


def fit_model(
    config: RewardConfig,
    work: Path,
    on_progress: Callable[[], None],
    *,
    training: Spec = TRAINING,
    absent: Sequence[str] = (),
) -> DualEncoderModel | None:
    """Returns the fitted model; None when the fit was stopped.

    Args:
        config: The service's configuration of the fit.
        work: Folder of datasets and fits.
        on_progress: Called now and then.
        training: What it learns from.
        absent: Phrases of which it is known that no image shows them.
    """

    def make_learner() -> RewardModelLearner:
        grounding, drawn = open_grounding(), open_or_draw(training, work)
        x, y, heat, presence = _located(grounding, drawn, work / "datasets" / name)
        heat, presence = (np.where(np.isin(PHRASES, absent), 0.0, each) for each in (heat, presence))
        relations, half_heat = image_relations(x, y, heat, presence, config)
        keypoints = place_keypoints(x, y, heat, presence)
        dataset = CaptionDataset((drawn.seen["frames"],), PHRASES, relations, half_heat, keypoints)
        parts = dataset.split(drawn.seen["lengths"], fraction=config.validation_fraction, seed=config.seed)
        spec, version = network_spec(grounding.network.spec, config), grounding_version()
        return RewardModelLearner(config, spec, *parts, grounding, version, f"{data} {version}", torch.device("cpu"))

    data = dataset_path(training, work).name
    name = f"{data}.{grounding_version()}.safetensors"
    inputs = [data, grounding_version(), *absent]
    folder = fit_once(config, inputs, make_learner, work=work, on_progress=on_progress)
    return None if folder is None else load_reward_model(folder, "cpu")


def open_grounding() -> GradCamModel:
    """Returns the grounding model that ships."""
    return load_built_in(_GROUNDING / grounding_version(), "cpu")


def grounding_version() -> str:
    """Returns the version of the grounding model that ships; FailedPrecondition unless there is one."""
    versions = [path.parent.name for path in _GROUNDING.glob("*/card.json")]
    if len(versions) != 1:
        raise FailedPrecondition(
            f"{_GROUNDING} must hold one version of the grounding model; it holds {len(versions)}.",
            hint="Run from a checkout.",
        )
    return versions[0]


def _located(grounding: GradCamModel, drawn: Drawn, path: Path) -> npt.NDArray[np.float64]:
    """Returns x, y, heat and presence of the phrases in the frames, float64 (4, N, P); `path` is a cache of them."""
    with locked(path.with_suffix(".lock")):
        if not path.is_file():
            found = grounding.ground(drawn.seen["frames"], PHRASES)
            located = np.stack([found.x, found.y, found.heat, found.presence])
            write_atomic(path, safetensors.numpy.save({"located": located}))
    return safetensors.numpy.load_file(path)["located"]
