"""Kind `collect`: records a behaviour in a task as a dataset, over the network.

<data>/datasets/<dataset>/        the dataset
<folder>/artifacts/dataset.json   its name, size and fingerprint
"""

import json
from collections.abc import Mapping
from functools import partial
from typing import Any

from freerein.atomic_files import write_atomic
from freerein.config import parse
from freerein.data import Dataset, dataset_path
from freerein_orchestrator.kinds.collect.config import PARTS_FIELD, CollectConfig
from freerein_orchestrator.kinds.collect.curiosity import explore
from freerein_orchestrator.kinds.collect.mix import record_mix
from freerein_orchestrator.kinds.collect.scripted import demonstrate
from freerein_orchestrator.kinds.context import RunContext
from freerein_orchestrator.kinds.kind import Kind
from freerein_orchestrator.kinds.policy_store import PolicyStore, is_step

CARD = "dataset.json"
"""Artifact that describes the dataset: `dataset`, `task`, `conditions`, `trajectories`, `timesteps`, `fingerprint`.

Of a mix also `parts`, each with its options, its `timesteps`, and what its policy is and learned from.
"""


def run(context: RunContext, config: CollectConfig) -> None:
    """Records the trajectories that are missing; a killed run continues and records nothing twice.

    Raises:
        Stopped: The run is to stop.
        ServiceError: The sim service refuses, or the dataset holds something else.
    """
    root = dataset_path(context.data_dir, config.dataset)
    parts: list[dict[str, Any]] = []
    if config.behaviour == "curiosity":
        explore(context, config, root)
    elif config.behaviour == "mix":
        parts = record_mix(context, config, root)
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
        **({"parts": parts} if parts else {}),
    }
    write_atomic(context.artifacts / CARD, json.dumps(card, indent=2).encode())


def check(config: CollectConfig, store: PolicyStore, earlier: Mapping[str, str]) -> None:
    """Checks that the policies of a mix exist or will.

    Raises:
        InvalidInput: One does not.
    """
    for part in config.mix:
        if not (part.is_random or is_step(part.policy, earlier, field=PARTS_FIELD)):
            store.folder(part.policy, field=PARTS_FIELD)


def truth(config: Mapping[str, Any], store: PolicyStore) -> str:
    """Returns the supervision of the privileged policies of a mix; empty for none."""
    found = (store.privileged_supervision(str(part["policy"])) for part in config.get("parts", ()))
    return "; ".join(filter(None, dict.fromkeys(found)))


KIND = Kind(
    {"": CollectConfig},
    partial(parse, CollectConfig),
    steps=lambda config: config.count,
    run=run,
    check=check,
    truth=truth,
    meaning="Records a scripted or a curious behaviour, or a mix of policies, in a task as a dataset.",
)
