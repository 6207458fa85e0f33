"""A fit as a process of its own: `python -m freerein_reward.fit FOLDER DATA_DIR DEVICE GROUNDING_FOLDER`.

FOLDER holds `config.json`; metrics and checkpoints are written there, and in the end `model/`. GROUNDING_FOLDER holds
the version of the grounding model that tells the captions; its name is the version. The exit codes are those of
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
from freerein.jobs.child import run_child, stop_on_sigterm
from freerein.jobs.metrics import MetricsWriter
from freerein.learning.fit import FitResult, fit
from freerein.learning.model_files import choose_device, save_model
from freerein_reward.model import REWARD, DualEncoder, load_grounding
from freerein_reward.relations import rivals
from freerein_reward.training import RewardConfig, RewardLearner, agreement, describe, design, hold_out

_MAX_PHRASES = 32  # each is told from each


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
    config = RewardConfig.from_mapping({"threads": threads, **values})
    opened = open_dataset(data_dir, dataset)
    cameras = tuple(choose_camera(opened, camera) for camera in config.cameras or ("",))
    distinct = {phrase.strip() for phrase in config.phrases} - {""}
    if not 2 <= len(config.phrases) == len(distinct) <= _MAX_PHRASES or any(map(rivals, distinct)):
        raise InvalidInput(
            f"`phrases` must be 2 to {_MAX_PHRASES} different noun phrases without words for relations, such as `on`; "
            f"got {len(config.phrases)}.",
            field="config.phrases",
            hint="Name every thing that a goal may speak of, such as: a red block.",
        )
    return asdict(replace(config, cameras=cameras))


def main(folder: Path, data_dir: Path, device: str, grounding: Path) -> int:
    """Fits a model, or goes on fitting it; returns the process's exit code."""

    def train(asked: Mapping[str, Any]) -> bool:
        config = RewardConfig.from_mapping(asked["config"])
        return _fit(folder, open_dataset(data_dir, asked["dataset"]), config, device, grounding)

    return run_child(folder, train)


def _fit(folder: Path, dataset: Dataset, config: RewardConfig, device: str, grounding: Path) -> bool:
    learner = _learner(folder, dataset, config, device, grounding)
    with stop_on_sigterm() as stop:
        fitted = fit(learner, folder, stop=stop)
    if fitted is None:
        return False
    save_model(fitted.network, folder / "model", card=_card(dataset, learner, fitted, grounding))
    return True


def _learner(folder: Path, dataset: Dataset, config: RewardConfig, device: str, grounding: Path) -> RewardLearner:
    finder = load_grounding(grounding, device)
    captions = folder / f"captions-{grounding.name}.safetensors"
    spec = design(finder.network.spec, config)  # refuses before anything takes long
    rows = None if captions.is_file() else MetricsWriter(folder / "metrics.jsonl", last_step=0)
    described = describe(
        dataset, finder, config, captions, on_share=lambda share: rows.append(0, {"captioned": share}) if rows else None
    )
    training, validation = hold_out(described, dataset.lengths, share=config.validation_fraction, seed=config.seed)
    return RewardLearner(
        config=config,
        spec=spec,
        training=training,
        validation=validation,
        grounding=finder,
        fingerprint=f"{dataset.fingerprint} {grounding.name}",
        device=choose_device(device),
    )


def _card(
    dataset: Dataset, learner: RewardLearner, fitted: FitResult[DualEncoder], grounding: Path
) -> Mapping[str, Any]:
    return {
        "kind": REWARD,
        "command": "freerein fit reward DATASET",
        "task": dataset.spec.task,
        "data": {"trajectories": len(dataset), "fingerprint": dataset.fingerprint},
        "grounding": grounding.name,
        "config": asdict(learner.config),
        "figures": {
            "validation_loss": fitted.validation_loss,
            "best_step": fitted.best_step,
            **agreement(fitted.network, learner.validation),
        },
        "supervision": "noun phrases; captions are told from pixels by the grounding model",
    }


if __name__ == "__main__":
    raise SystemExit(main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3], Path(sys.argv[4])))
