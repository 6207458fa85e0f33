"""Datasets, models and runs that are in use: a fit or run that has not ended names them in its configuration."""

import json
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from freerein.errors import FailedPrecondition, NotFound
from freerein.jobs.store import JobStore
from freerein.types.common import ModelRef

_MODEL_KEYS = ("model", "reward_model")
_DATASET_KEYS = ("dataset", "name")  # the latter of a run of kind `skills`
_RUN = re.compile(r"[0-9a-f]{6,32}")

IsNamed = Callable[[Mapping[str, Any]], bool]
"""Whether the configuration of a job names what may be in use."""


def check_unused(data_dir: Path, what: str, is_named: IsNamed) -> None:
    """Checks that no fit and no run names something, unless it has ended.

    Args:
        data_dir: The data directory.
        what: What must be unused, at the beginning of a sentence.
        is_named: Whether a configuration names it.

    Raises:
        FailedPrecondition: A fit or run names it, or may, for its configuration is damaged.
    """
    for store in _stores(data_dir):
        for job_id in store.unfinished():
            job = f"{store.noun} {job_id[:8]}, which has not ended"
            try:
                is_used = is_named(store.config(job_id))
            except NotFound:  # deleted meanwhile
                continue
            except (OSError, ValueError, TypeError):
                raise FailedPrecondition(
                    f"{what} must not be in use; {job}, may name it: its configuration is damaged.",
                    hint=f"Delete the folder of {store.noun} {job_id} in the data directory, or restore its config.json.",
                ) from None
            if is_used:
                command = f"freerein {'fit' if store.noun == 'fit' else 'runs'}"
                raise FailedPrecondition(
                    f"{what} must not be in use; {job}, names it.",
                    hint=f"Wait for its end, or end it: `{command} cancel {job_id[:8]}`.",
                )


def names_dataset(name: str) -> IsNamed:
    """Returns whether a configuration names a dataset."""
    return lambda config: any(part.get(key) == name for part in _objects(config) for key in _DATASET_KEYS)


def names_model(ref: ModelRef) -> IsNamed:
    """Returns whether a configuration names a model: this version of it, or none, which may have been chosen since."""
    return lambda config: any(
        part.get(key) == ref.name and part.get("version", "") in ("", ref.version)
        for part in _objects(config)
        for key in _MODEL_KEYS
    )


def names_run(run_id: str) -> IsNamed:
    """Returns whether a configuration names a run, by its id or the first digits of it."""
    return lambda config: any(run_id.startswith(digits) for digits in _RUN.findall(json.dumps(config)))


def _stores(data_dir: Path) -> Iterator[JobStore]:
    yield JobStore(data_dir / "runs", noun="run")
    for folder in sorted((data_dir / "fits").glob("*")):
        yield JobStore(folder, noun="fit")


def _objects(value: object) -> Iterator[Mapping[str, Any]]:
    """Yields the JSON objects in a value, itself included."""
    if isinstance(value, Mapping):
        yield value
    for each in value.values() if isinstance(value, Mapping) else value if isinstance(value, list) else ():
        yield from _objects(each)
