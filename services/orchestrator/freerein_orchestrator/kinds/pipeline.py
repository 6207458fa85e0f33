"""Kind `pipeline`: runs of other kinds in order, as steps of one run.

<folder>/parts/<step>/           the step's own folder
         parts/<step>/done.json  its number of steps, once it is done: it is not repeated
         artifacts/<step>.<name> the artifacts of the steps that are done
"""

import json
import os
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from freerein.atomic_files import fsync_folder, write_atomic
from freerein.errors import InvalidInput, ServiceError
from freerein.learning.config import parse
from freerein.types.common import check_name
from freerein_orchestrator.kinds.context import RunContext
from freerein_orchestrator.kinds.kind import Kind
from freerein_orchestrator.kinds.metrics_logger import last_step
from freerein_orchestrator.kinds.policy_store import PolicyStore

_MAX_NAME = 24
"""Characters: a step's key, and the names of its artifacts, must not exceed what names may have."""
_DONE = "done.json"


@dataclass(frozen=True)
class PipelineConfig:
    """Configuration of a run of kind `pipeline`.

    Attributes:
        steps: The steps in order, each an object; see `StepConfig`.
    """

    steps: tuple[dict[str, Any], ...]


@dataclass(frozen=True)
class StepConfig:
    """A step of a pipeline.

    Attributes:
        name: Its name; later steps may use it in place of a run's id.
        kind: Its kind.
        config: The kind's configuration.
    """

    name: str
    kind: str
    config: dict[str, Any]


@dataclass(frozen=True)
class Step:
    """A parsed step."""

    name: str
    kind: str
    config: Any


@dataclass(frozen=True)
class Pipeline:
    """A parsed pipeline."""

    steps: tuple[Step, ...]


def pipeline_kind(kinds: Mapping[Any, Kind[Any]]) -> Kind[Pipeline]:
    """Returns the kind `pipeline`, whose steps may be of `kinds`."""

    def parse_pipeline(values: Mapping[str, Any]) -> Pipeline:
        steps = [parse(StepConfig, step) for step in parse(PipelineConfig, values).steps]
        _check_names([step.name for step in steps])
        return Pipeline(tuple(parse_step(step) for step in steps))

    def parse_step(step: StepConfig) -> Step:
        if step.kind not in kinds:
            raise InvalidInput(
                f"The kind of a step must be one of {', '.join(kinds)}; got another.",
                field="config.steps.kind",
                hint="A pipeline holds no other pipeline.",
            )
        with _step_errors(step.name):
            return Step(step.name, step.kind, kinds[step.kind].parse(step.config))

    def dump(pipeline: Pipeline) -> dict[str, Any]:
        steps = pipeline.steps
        return {"steps": [{**vars(step), "config": kinds[step.kind].dump(step.config)} for step in steps]}

    def steps(pipeline: Pipeline) -> int:
        return sum(kinds[step.kind].steps(step.config) for step in pipeline.steps)

    def check(pipeline: Pipeline, store: PolicyStore, _earlier: Collection[str]) -> None:
        earlier: list[str] = []
        for step in pipeline.steps:
            with _step_errors(step.name):
                kinds[step.kind].check(step.config, store, earlier)
            earlier.append(step.name)

    def run(context: RunContext, pipeline: Pipeline) -> None:
        done = 0
        for step in pipeline.steps:
            child = context.child(step.name, first_step=done)
            child.folder.mkdir(parents=True, exist_ok=True)
            if not (child.folder / _DONE).is_file():
                with _step_errors(step.name), child.closing:
                    kinds[step.kind].run(child, step.config)
                _finish(context, child, step.name)
            done += int(json.loads((child.folder / _DONE).read_bytes())["steps"])

    return Kind(parse_pipeline, steps, run, check, dump)


def _check_names(names: list[str]) -> None:
    if not names or len(set(names)) < len(names):
        raise InvalidInput(
            f"A pipeline must have steps with different names; got {len(names)} steps and {len(set(names))} names.",
            field="config.steps",
            hint="Later steps refer to earlier ones by name.",
        )
    for name in names:
        if len(check_name(name, field="config.steps.name")) > _MAX_NAME:
            raise InvalidInput(
                f"The name of a step must have at most {_MAX_NAME} characters; got {len(name)}.",
                field="config.steps.name",
                hint="Choose a shorter one.",
            )


@contextmanager
def _step_errors(name: str) -> Iterator[None]:
    """Adds the step's name to errors."""
    try:
        yield
    except ServiceError as error:
        raise type(error)(
            f"In step {name}: {error.detail}",
            field=error.field.replace("config", "config.steps.config", 1),
            hint=error.hint,
            retry_after_s=error.retry_after_s,
        ) from error


def _finish(context: RunContext, child: RunContext, name: str) -> None:
    """Links a step's artifacts into the run's, and records that it is done."""
    for artifact in child.artifacts.iterdir():
        link = context.artifacts / f"{name}.{artifact.name}"
        link.unlink(missing_ok=True)
        os.link(artifact, link)
    fsync_folder(context.artifacts)
    steps = max(0, last_step(context.run_folder) - child.first_step)
    write_atomic(child.folder / _DONE, json.dumps({"steps": steps}).encode())
