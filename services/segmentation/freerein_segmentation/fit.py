"""A fit as a process of its own: `python -m freerein_segmentation.fit FOLDER DATA_DIR DEVICE`.

FOLDER holds `config.json`; metrics and checkpoints are written there, and in the end `model/`. Exit code 0 says that it
is there, 1 that the fit was stopped and can go on, 2 that it cannot succeed, for the reason on stderr's last line.
"""

import json
import sys
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import torch

from freerein.data import Dataset, dataset_path
from freerein.errors import InvalidInput, NotFound, ServiceError
from freerein.learning.fit import Fitted, fit, stop_on_sigterm
from freerein.serving.child import end_with_parent
from freerein.serving.fits import HOPELESS
from freerein_segmentation import model
from freerein_segmentation.training import (
    Demonstrations,
    SegmentationConfig,
    SegmentationProblem,
    design,
    hold_out,
)

STOPPED = 1


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
    opened = _open(data_dir, dataset)
    config = replace(config, camera=_camera(opened, config.camera))
    if not opened.spec.skills or not all(opened.skills):
        raise InvalidInput(
            f"A dataset to learn from must name the skills of each of its {len(opened)} trajectories; some have none.",
            field="dataset",
            hint="Tag them, or record with the expert: freerein dataset check NAME says more.",
        )
    return asdict(config)


def main(folder: Path, data_dir: Path, device: str) -> int:
    """Fits a model, or goes on fitting it; returns the process's exit code."""
    end_with_parent()
    asked = json.loads((folder / "config.json").read_bytes())
    try:
        return _fit(folder, _open(data_dir, asked["dataset"]), SegmentationConfig.from_mapping(asked["config"]), device)
    except ServiceError as error:
        sys.stderr.write(f"{error.detail} {error.hint}\n")
        return HOPELESS


def _fit(folder: Path, dataset: Dataset, config: SegmentationConfig, device: str) -> int:
    problem = _problem(dataset, config, device)
    with stop_on_sigterm() as stop:
        fitted = fit(problem, config.plan, folder, stop=stop)
    if fitted is None:
        return STOPPED
    model.export(fitted.network, folder / "model", card=_card(dataset, problem, fitted))
    return 0


def _problem(dataset: Dataset, config: SegmentationConfig, device: str) -> SegmentationProblem:
    demonstrations = Demonstrations(dataset.cached_frames(config.camera), dataset.cached_actions(), dataset.skills)
    action = dataset.spec.action
    spec = design(config, demonstrations, skills=dataset.spec.skills, action_choices=action.choices)
    training, validation = hold_out(demonstrations, share=config.validation_share, seed=config.seed)
    chosen = ("cuda" if torch.cuda.is_available() else "cpu") if device == "auto" else device
    return SegmentationProblem(config, spec, training, validation, dataset.fingerprint, torch.device(chosen))


def _card(dataset: Dataset, problem: SegmentationProblem, fitted: Fitted[Any]) -> dict[str, Any]:
    return {
        "task": dataset.spec.task,
        "data": {"trajectories": len(dataset), "fingerprint": dataset.fingerprint},
        "config": asdict(problem.config),
        "figures": {"validation_loss": fitted.validation_loss, "best_step": fitted.best_step},
        "supervision": "the set of skills of each trajectory",
    }


def _open(data_dir: Path, name: str) -> Dataset:
    path = dataset_path(data_dir, name)
    if not path.is_dir():
        raise NotFound(
            "The dataset must be one of those in the data directory; there is none of that name.",
            field="dataset",
            hint="Record one: freerein sim demonstrate TASK --out NAME.",
        )
    return Dataset(path)


def _camera(dataset: Dataset, asked: str) -> str:
    cameras = tuple(dataset.spec.cameras)
    if asked not in (cameras if asked or len(cameras) > 1 else ("",)):
        raise InvalidInput(
            f"`camera` must name one of the dataset's, {', '.join(cameras)}; got {'another' if asked else 'none'}.",
            field="config.camera",
            hint="A model sees one camera.",
        )
    return asked or cameras[0]


if __name__ == "__main__":
    raise SystemExit(main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]))
