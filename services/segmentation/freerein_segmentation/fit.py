"""The child process of a fit: `python -m freerein_segmentation.fit FOLDER DATA_DIR DEVICE`.

FOLDER holds `config.json`; metrics, checkpoints and `model/` are written there. Exit codes are those of
`freerein.jobs.child`.
"""

import sys
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from freerein.data import Dataset
from freerein.data.lookup import choose_camera, open_dataset
from freerein.errors import InvalidInput
from freerein.jobs.child import run_child
from freerein.learning.fit import FitResult, fit_and_save
from freerein.learning.model_files import choose_device, save_model
from freerein_segmentation.model import ModelSpec, SegmentationNetwork
from freerein_segmentation.training import Demonstrations, SegmentationConfig, SegmentationLearner, network_spec


def resolve(data_dir: Path, dataset: str, values: Mapping[str, Any], *, threads: int) -> dict[str, Any]:
    """Returns the complete configuration of a fit; `values` override the defaults.

    Raises NotFound without such a dataset, InvalidInput for a configuration or a dataset that cannot be learned from.
    """
    config = SegmentationConfig.from_mapping({"threads": threads, **values})
    opened = open_dataset(data_dir, dataset)
    config = replace(config, camera=choose_camera(opened, config.camera))
    if not opened.spec.skills or not all(opened.skills):
        raise InvalidInput(
            f"Each of the dataset's {len(opened)} trajectories must name its skills; some do not.",
            field="dataset",
            hint="Tag them, or record with the expert; run: freerein dataset check NAME.",
        )
    unknown = {skill for tags in opened.skills for skill in tags} - set(opened.spec.skills)
    if unknown:
        raise InvalidInput(
            f"Tags must be among the dataset's {len(opened.spec.skills)} skills; {len(unknown)} tags are not.",
            field="dataset",
            hint="Correct the tags; run: freerein dataset check NAME.",
        )
    _spec(opened, config)  # rejects frames and actions that are out of bounds
    return asdict(config)


def main(folder: Path, data_dir: Path, device: str) -> int:
    """Runs or resumes a fit; returns the process's exit code."""

    def train(job: Mapping[str, Any]) -> bool:
        dataset = open_dataset(data_dir, job["dataset"])
        config = SegmentationConfig.from_mapping(job["config"])
        learner = _learner(dataset, config, device)

        def save(fitted: FitResult[SegmentationNetwork], path: Path) -> None:
            save_model(fitted.network, path, card=_card(dataset, config, fitted))

        return fit_and_save(learner, folder, save)

    return run_child(folder, train)


def _learner(dataset: Dataset, config: SegmentationConfig, device: str) -> SegmentationLearner:
    demonstrations = Demonstrations(dataset.cached_frames(config.camera), dataset.cached_actions(), dataset.skills)
    training, validation = demonstrations.split(fraction=config.validation_fraction, seed=config.seed)
    return SegmentationLearner(
        config, _spec(dataset, config), training, validation, dataset.fingerprint, choose_device(device)
    )


def _spec(dataset: Dataset, config: SegmentationConfig) -> ModelSpec:
    spec = dataset.spec
    return network_spec(config, frame=spec.cameras[config.camera], action=spec.action, skills=spec.skills)


def _card(dataset: Dataset, config: SegmentationConfig, fitted: FitResult[SegmentationNetwork]) -> dict[str, Any]:
    return {
        "command": "freerein fit segmentation DATASET",
        "task": dataset.spec.task,
        "data": {"trajectories": len(dataset), "fingerprint": dataset.fingerprint},
        "config": asdict(config),
        "figures": fitted.figures,
        "supervision": "the set of skills of each trajectory",
    }


if __name__ == "__main__":
    raise SystemExit(main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]))
