"""Kind `collect`: what a behaviour does in a task is recorded into a dataset, over the network.

<data>/datasets/<dataset>/        what it did
<folder>/artifacts/dataset.json   what that came to
"""

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from freerein.atomic_files import write_atomic
from freerein.data import Dataset, dataset_path
from freerein.learning.config import parse
from freerein_orchestrator.kinds.collect_config import CollectConfig
from freerein_orchestrator.kinds.collect_curiosity import explore
from freerein_orchestrator.kinds.collect_demonstrations import demonstrate
from freerein_orchestrator.kinds.kind import Kind
from freerein_orchestrator.patience import Stopped
from freerein_orchestrator.work import Work

CARD = "dataset.json"
"""The artifact that names the dataset: `dataset`, `trajectories`, `timesteps` and `fingerprint`."""


def resolve(config: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the whole configuration.

    Raises:
        InvalidInput: It cannot be.
    """
    return asdict(parse(CollectConfig, config))


def steps(config: Mapping[str, Any]) -> int:
    """Returns the number of trajectories."""
    return int(config["count"])


def run(work: Work) -> bool:
    """Records what is missing; killed, it goes on where it stood, and records nothing twice.

    Raises:
        ServiceError: The sim service refuses, or the dataset holds something else.
    """
    config = parse(CollectConfig, work.config)
    root = dataset_path(work.data_dir, config.dataset)
    try:
        if config.behaviour == "curiosity":
            explore(work, config, root)
        else:
            demonstrate(work, config, config.behaviour, root)
    except Stopped:
        return False
    _note_dataset(work, config, root)
    return True


KIND = Kind(resolve, steps, run)


def _note_dataset(work: Work, config: CollectConfig, root: Path) -> None:
    """Leaves behind what there is now, so that it can be told from another dataset of the same name."""
    dataset = Dataset(root)
    card = {
        "dataset": config.dataset,
        "trajectories": len(dataset),
        "timesteps": int(dataset.lengths.sum()),
        "fingerprint": dataset.fingerprint,
    }
    write_atomic(work.artifacts / CARD, json.dumps(card, indent=2).encode())
