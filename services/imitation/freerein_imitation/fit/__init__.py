"""A fit as a child process: `python -m freerein_imitation.fit FOLDER DATA_DIR DEVICE`.

FOLDER holds `config.json`, and gets metrics, checkpoints and in the end `model/`. The exit codes are those of
`freerein.jobs.child`. The configuration's `policy` selects the method, a module with three functions:
`resolve` completes a configuration, `prepare` makes the learner, `save` writes the model.
"""

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import Any

import torch

from freerein.data.lookup import choose_camera
from freerein.errors import InvalidInput
from freerein.jobs.child import run_child
from freerein.learning.fit import fit_and_save
from freerein_imitation.fit import goal_conditioned, language, skills
from freerein_imitation.fit.dataset import open_dataset

_METHODS: Mapping[str, ModuleType] = MappingProxyType(
    {"goal_conditioned": goal_conditioned, "skills": skills, "language": language}
)


def resolve(data_dir: Path, dataset: str, values: Mapping[str, Any], *, threads: int) -> dict[str, Any]:
    """Returns the complete configuration of a fit.

    Args:
        data_dir: Data directory.
        dataset: Name of the dataset.
        values: Requested configuration.
        threads: Threads of torch, unless requested otherwise.

    Raises:
        NotFound: There is no such dataset.
        InvalidInput: The configuration is invalid, or the dataset cannot be trained on.
        FailedPrecondition: The dataset has no skill labels, or the text encoder is not installed.
    """
    method, source = _method(values), open_dataset(data_dir, dataset)
    camera = choose_camera(source.dataset, values.get("camera", ""))
    return asdict(method.resolve(source, {"threads": threads, **values, "camera": camera}))


def main(folder: Path, data_dir: Path, device: str) -> int:
    """Runs a fit, or continues it; returns the process's exit code."""

    def train(job: Mapping[str, Any]) -> bool:
        values: Mapping[str, Any] = job["config"]
        method, source = _method(values), open_dataset(data_dir, job["dataset"])
        torch.set_num_threads(values["threads"])
        learner = method.prepare(source, values, device)
        return fit_and_save(learner, folder, lambda fitted, model: method.save(model, source, learner, fitted))

    return run_child(folder, train)


def _method(values: Mapping[str, Any]) -> ModuleType:
    policy = values.get("policy", "goal_conditioned")
    if not isinstance(policy, str) or policy not in _METHODS:
        raise InvalidInput(
            f"`policy` must be {' or '.join(_METHODS)}; got something else.",
            field="config.policy",
            hint="Leave it out for goal images.",
        )
    return _METHODS[policy]
