"""Kind `collect`: records a behaviour in a task as a dataset, over the network.

<data>/datasets/<dataset>/        the dataset
<folder>/artifacts/dataset.json   its name, size and fingerprint
"""

import json
from functools import partial

from freerein.atomic_files import write_atomic
from freerein.config import parse
from freerein.data import Dataset, dataset_path
from freerein_orchestrator.kinds.collect.config import CollectConfig
from freerein_orchestrator.kinds.collect.curiosity import explore
from freerein_orchestrator.kinds.collect.scripted import demonstrate
from freerein_orchestrator.kinds.context import RunContext
from freerein_orchestrator.kinds.kind import Kind

CARD = "dataset.json"
"""Artifact that describes the dataset: `dataset`, `task`, `conditions`, `trajectories`, `timesteps`, `fingerprint`."""


def run(context: RunContext, config: CollectConfig) -> None:
    """Records the trajectories that are missing; a killed run continues and records nothing twice.

    Raises:
        Stopped: The run is to stop.
        ServiceError: The sim service refuses, or the dataset holds something else.
    """
    root = dataset_path(context.data_dir, config.dataset)
    if config.behaviour == "curiosity":
        explore(context, config, root)
    else:
        demonstrate(context, config, config.behaviour, root)
    dataset = Dataset(root)
    card = {
        "dataset": config.dataset,
        "task": config.task,
        "conditions": sorted(config.conditions),
        "trajectories": len(dataset),
        "timesteps": int(dataset.lengths.sum()),
        "fingerprint": dataset.fingerprint,
    }
    write_atomic(context.artifacts / CARD, json.dumps(card, indent=2).encode())


KIND = Kind(
    {"": CollectConfig},
    partial(parse, CollectConfig),
    steps=lambda config: config.count,
    run=run,
    meaning="Records a scripted or a curious behaviour in a task as a dataset.",
)
