"""The child process of a fit: `python -m freerein_reward.fit FOLDER DATA_DIR DEVICE GROUNDING_FOLDER`.

FOLDER holds `config.json`; metrics, checkpoints and `model/` are written there. GROUNDING_FOLDER holds a version of the
grounding model and is named after it. Exit codes are those of `freerein.jobs.child`.
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
from freerein.jobs.metrics import MetricsWriter
from freerein.learning.fit import FitResult, fit_and_save
from freerein.learning.model_files import choose_device, save_model
from freerein_reward.model import REWARD, DualEncoder, load_grounding
from freerein_reward.relations import rival_captions
from freerein_reward.training import RewardConfig, RewardModelLearner, caption_images, evaluate_reward, network_spec

_MAX_PHRASES = 32  # captions and time grow with the square


def resolve(data_dir: Path, dataset: str, values: Mapping[str, Any], *, threads: int) -> dict[str, Any]:
    """Returns the complete configuration of a fit; `values` override the defaults.

    Raises NotFound without such a dataset, InvalidInput for a configuration or a dataset that cannot be learned from.
    """
    config = RewardConfig.from_mapping({"threads": threads, **values})
    opened = open_dataset(data_dir, dataset)
    cameras = tuple(choose_camera(opened, camera) for camera in config.cameras or ("",))
    distinct = {phrase.strip() for phrase in config.phrases} - {""}
    if not 2 <= len(config.phrases) == len(distinct) <= _MAX_PHRASES or any(map(rival_captions, distinct)):
        raise InvalidInput(
            f"`phrases` must be 2 to {_MAX_PHRASES} distinct noun phrases without relations such as `on`; "
            f"got {len(config.phrases)}.",
            field="config.phrases",
            hint="Name every object of the goal texts, such as: a red block.",
        )
    return asdict(replace(config, cameras=cameras))


def main(folder: Path, data_dir: Path, device: str, grounding: Path) -> int:
    """Runs or resumes a fit; returns the process's exit code."""

    def train(job: Mapping[str, Any]) -> bool:
        dataset, config = open_dataset(data_dir, job["dataset"]), RewardConfig.from_mapping(job["config"])
        learner = _learner(folder, dataset, config, device, grounding)

        def save(fitted: FitResult[DualEncoder], path: Path) -> None:
            save_model(fitted.network, path, card=_card(dataset, learner, fitted, grounding))

        return fit_and_save(learner, folder, save)

    return run_child(folder, train)


def _learner(folder: Path, dataset: Dataset, config: RewardConfig, device: str, grounding: Path) -> RewardModelLearner:
    model = load_grounding(grounding, device)
    captions = folder / f"captions-{grounding.name}.safetensors"
    spec = network_spec(model.network.spec, config)  # rejects what is out of bounds before captioning
    rows = None if captions.is_file() else MetricsWriter(folder / "metrics.jsonl", last_step=0)
    images = caption_images(
        dataset, model, config, captions, on_progress=lambda done: rows.append(0, {"captioned": done}) if rows else None
    )
    training, validation = images.split(dataset.lengths, fraction=config.validation_fraction, seed=config.seed)
    return RewardModelLearner(
        config=config,
        spec=spec,
        training=training,
        validation=validation,
        grounding=model,
        fingerprint=f"{dataset.fingerprint} {grounding.name}",
        device=choose_device(device),
    )


def _card(
    dataset: Dataset, learner: RewardModelLearner, fitted: FitResult[DualEncoder], grounding: Path
) -> Mapping[str, Any]:
    return {
        "kind": REWARD,
        "command": "freerein fit reward DATASET",
        "task": dataset.spec.task,
        "data": {"trajectories": len(dataset), "fingerprint": dataset.fingerprint},
        "grounding": grounding.name,
        "config": asdict(learner.config),
        "figures": {**fitted.figures, **evaluate_reward(fitted.network, learner.validation)},
        "supervision": "noun phrases; captions made from pixels by the grounding model",
    }


if __name__ == "__main__":
    raise SystemExit(main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3], Path(sys.argv[4])))
