"""A fit as a process of its own: `python -m freerein_segmentation.fit FOLDER DATA_DIR DEVICE`.

FOLDER holds `config.json`; metrics and checkpoints are written there, and in the end `model/`. The exit codes are those
of `freerein.jobs.child`.
"""

import sys
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from freerein.data import Dataset
from freerein.data.lookup import choose_camera, open_dataset
from freerein.errors import InvalidInput
from freerein.jobs.child import run_child, stop_on_sigterm
from freerein.learning.fit import FitResult, fit
from freerein.learning.model_files import choose_device, save_model
from freerein_segmentation.model import ModelSpec
from freerein_segmentation.training import (
    Demonstrations,
    SegmentationConfig,
    SegmentationLearner,
    design,
    hold_out,
)


def resolve(data_dir: Path, dataset: str, values: Mapping[str, Any], *, threads: int) -> dict[str, Any]:
    """Returns the whole configuration of a fit.

    Args:
        data_dir: The data directory.
        dataset: A dataset's name.
        values: What was asked for.
        threads: Of torch, where not asked for.

    Raises:
        NotFound: There is no such dataset.
        InvalidInput: The configuration is wrong, or the dataset cannot be learned from.
    """
    config = SegmentationConfig.from_mapping({"threads": threads, **values})
    opened = open_dataset(data_dir, dataset)
    config = replace(config, camera=choose_camera(opened, config.camera))
    if not opened.spec.skills or not all(opened.skills):
        raise InvalidInput(
            f"A dataset to learn from must name the skills of each of its {len(opened)} trajectories; some have none.",
            field="dataset",
            hint="Tag them, or record with the expert: freerein dataset check NAME says more.",
        )
    unknown = {skill for tags in opened.skills for skill in tags} - set(opened.spec.skills)
    if unknown:
        raise InvalidInput(
            f"Trajectories must be tagged with the dataset's {len(opened.spec.skills)} skills; "
            f"{len(unknown)} tags are others.",
            field="dataset",
            hint="Tag them anew: freerein dataset check NAME says more.",
        )
    _spec(opened, config)  # refuses what there is no network for
    return asdict(config)


def main(folder: Path, data_dir: Path, device: str) -> int:
    """Fits a model, or goes on fitting it; returns the process's exit code."""

    def train(asked: Mapping[str, Any]) -> bool:
        config = SegmentationConfig.from_mapping(asked["config"])
        return _fit(folder, open_dataset(data_dir, asked["dataset"]), config, device)

    return run_child(folder, train)


def _fit(folder: Path, dataset: Dataset, config: SegmentationConfig, device: str) -> bool:
    learner = _learner(dataset, config, device)
    with stop_on_sigterm() as stop:
        fitted = fit(learner, config.plan, folder, stop=stop)
    if fitted is None:
        return False
    save_model(fitted.network, folder / "model", card=_card(dataset, learner, fitted))
    return True


def _learner(dataset: Dataset, config: SegmentationConfig, device: str) -> SegmentationLearner:
    demonstrations = Demonstrations(dataset.cached_frames(config.camera), dataset.cached_actions(), dataset.skills)
    training, validation = hold_out(demonstrations, share=config.validation_fraction, seed=config.seed)
    return SegmentationLearner(
        config, _spec(dataset, config), training, validation, dataset.fingerprint, choose_device(device)
    )


def _spec(dataset: Dataset, config: SegmentationConfig) -> ModelSpec:
    spec = dataset.spec
    return design(config, frame=spec.cameras[config.camera], action=spec.action, skills=spec.skills)


def _card(dataset: Dataset, learner: SegmentationLearner, fitted: FitResult[Any]) -> dict[str, Any]:
    return {
        "command": "freerein fit segmentation DATASET",
        "task": dataset.spec.task,
        "data": {"trajectories": len(dataset), "fingerprint": dataset.fingerprint},
        "config": asdict(learner.config),
        "figures": {"validation_loss": fitted.validation_loss, "best_step": fitted.best_step},
        "supervision": "the set of skills of each trajectory",
    }


if __name__ == "__main__":
    raise SystemExit(main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]))
