"""Datasets, models and runs that are in use: a fit or run that has not ended names them in its configuration."""

import json
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from freerein.errors import FailedPrecondition, NotFound
from freerein.jobs.store import JobStore
from freerein.types.common import ModelRef

_RUN = re.compile(r"[0-9a-f]{6,32}")

IsNamed = Callable[[str, Mapping[str, Any]], bool]
"""Whether a job, by its id and configuration, names what may be in use."""


def check_unused(data_dir: Path, what: str, is_named: IsNamed) -> None:
    """Raises FailedPrecondition where a fit or run that has not ended names `what`, which begins a sentence.

    Also where one may, for its configuration is damaged.
    """
    for store in _stores(data_dir):
        for job_id in store.unfinished():
            job = f"{store.noun} {job_id[:8]}"
            try:
                is_used = is_named(job_id, store.config(job_id))
            except NotFound:  # deleted meanwhile
                continue
            except (OSError, ValueError, TypeError):
                raise FailedPrecondition(
                    f"{what} must not be in use; {job}, which has not ended, may name it, but its configuration is "
                    "damaged.",
                    hint=f"Restore its config.json, or delete its folder, whose name begins with {job_id[:8]}.",
                ) from None
            if is_used:
                raise FailedPrecondition(
                    f"{what} must not be in use; {job}, which has not ended, names it.",
                    hint=f"Wait for its end, or end it: `freerein jobs cancel {job_id[:8]}`.",
                )


def names_dataset(name: str) -> IsNamed:
    """Returns whether a job names a dataset; one that a run makes without a name for it begins with the run's id."""
    return lambda job_id, config: (
        name.partition(".")[0] == job_id
        or any(
            name in (part.get("dataset"), _shared_name(part), *_iterations(part, "dataset"))
            for part in _objects(config)
        )
    )


def names_model(ref: ModelRef) -> IsNamed:
    """Returns whether a job names a model: this version of it, or none, which may have been chosen since."""
    keys = ("model", "reward_model")
    return lambda _, config: any(
        (
            ref.name in (*map(part.get, keys), _shared_name(part), *_iterations(part, "model_name"))
            and part.get("version", "") in ("", ref.version)
        )
        or (part.get("recognizer") == ref.name and part.get("recognizer_version", "") in ("", ref.version))
        for part in _objects(config)
    )


def names_run(run_id: str) -> IsNamed:
    """Returns whether a job names a run, by its id or the first digits of it."""
    return lambda _, config: any(run_id.startswith(digits) for digits in _RUN.findall(json.dumps(config)))


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


def _shared_name(part: Mapping[str, Any]) -> object:
    """Returns the name that a run of kind `skills` gives its dataset and models; None for a step of a pipeline."""
    return None if "kind" in part else part.get("name")


def _iterations(part: Mapping[str, Any], key: str) -> Iterator[str]:
    """Yields the names of what a run of kind `distill` makes in iterations before the last."""
    return (f"{part.get(key)}.{iteration}" for iteration in range(part.get("dagger_iterations", 0)))
