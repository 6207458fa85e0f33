"""Kind `pipeline`: runs of other kinds in order, as steps of one run.

A fit is work of another service: it may begin before its turn, beside the steps above it.

<folder>/parts/<step>/           the step's own folder
         parts/<step>/seconds    how long its attempts have taken so far; one that is killed counts for nothing
         parts/<step>/done.json  its number of steps, and those seconds, once it is done: it is not repeated
         artifacts/steps.json    name, kind, number of steps and seconds of the steps that are done
         artifacts/<step>.<name> the artifacts of the steps that are done
"""

import json
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

from freerein.atomic_files import fsync_folder, storage_errors, write_atomic
from freerein.clients.tasks import select_task
from freerein.config import parse
from freerein.errors import InvalidInput, ServiceError, must_be, quoted
from freerein.types.common import check_name
from freerein.types.sim import ListTasksRequest
from freerein_orchestrator.kinds.context import RunContext
from freerein_orchestrator.kinds.fit import FitRunConfig
from freerein_orchestrator.kinds.kind import Kind
from freerein_orchestrator.kinds.metrics_logger import last_step
from freerein_orchestrator.kinds.policy_store import PolicyStore
from freerein_orchestrator.rl.errors import Stopped

_MAX_NAME = 24
"""Characters: a step's key, and the names of its artifacts, must not exceed what names may have."""
_DONE, _SECONDS = "done.json", "seconds"

STEPS = "steps.json"
"""The artifact that lists the steps that are done."""


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
        after: Of a fit: earlier steps after which it begins, beside those between; empty for all earlier ones.
    """

    name: str
    kind: str
    config: dict[str, Any]
    after: tuple[str, ...] = ()


@dataclass(frozen=True)
class Step(StepConfig):
    """A step whose `config` is parsed."""

    config: Any


@dataclass(frozen=True)
class Pipeline:
    """A parsed pipeline."""

    steps: tuple[Step, ...]


def make_step(name: str, kind: str, **config: Any) -> dict[str, Any]:
    """Returns a step as a configuration has it."""
    return {"name": name, "kind": kind, "config": config}


def pipeline_kind(kinds: Mapping[Any, Kind[Any]]) -> Kind[Pipeline]:
    """Returns the kind `pipeline`, whose steps may be of `kinds`."""

    def parse_pipeline(values: Mapping[str, Any]) -> Pipeline:
        steps = [parse(StepConfig, step) for step in parse(PipelineConfig, values).steps]
        _check_names([step.name for step in steps])
        _check_after(steps, [name for name, kind in kinds.items() if kind.remote])
        return Pipeline(tuple(_parse_step(kinds, step) for step in steps))

    def dump(pipeline: Pipeline) -> dict[str, Any]:
        steps = pipeline.steps
        return {"steps": [{**vars(step), "config": kinds[step.kind].dump(step.config)} for step in steps]}

    def steps(pipeline: Pipeline) -> int:
        return sum(kinds[step.kind].steps(step.config) for step in pipeline.steps)

    def check(pipeline: Pipeline, store: PolicyStore, _earlier: Mapping[str, str]) -> None:
        earlier: dict[str, str] = {}
        for step in pipeline.steps:
            with _step_errors(step.name):
                kinds[step.kind].check(step.config, store, earlier)
            earlier[step.name] = _kind_of(step)

    def truth(config: Mapping[str, Any], store: PolicyStore) -> str:
        truths = [kinds[step["kind"]].truth(step["config"], store) for step in config["steps"] if step["kind"] in kinds]
        return "; ".join(filter(None, dict.fromkeys(truths)))

    meaning = "Does runs of other kinds in order, as steps of one run."
    run = partial(_run, kinds)
    return Kind({"": PipelineConfig}, parse_pipeline, steps, run, check, dump, truth, meaning=meaning)


def _kind_of(step: Step) -> str:
    """Returns the kind of a step; of a fit, with the service that has its model."""
    return f"{step.kind} of {step.config.service}" if isinstance(step.config, FitRunConfig) else step.kind


def _parse_step(kinds: Mapping[Any, Kind[Any]], step: StepConfig) -> Step:
    if step.kind not in kinds:
        raise InvalidInput(
            f"The kind of a step must be one of {', '.join(kinds)}; got another.",
            field="config.steps.kind",
            hint="A pipeline holds no other pipeline.",
        )
    with _step_errors(step.name):
        return Step(step.name, step.kind, kinds[step.kind].parse(step.config), step.after)


def _run(kinds: Mapping[Any, Kind[Any]], context: RunContext, pipeline: Pipeline) -> None:
    """Runs the steps that are not done; cancels the fits that have begun where the run is cancelled or fails."""
    done = 0
    try:
        _check_tasks(context, _to_do(context, pipeline))
        for step in pipeline.steps:
            _begin(kinds, context, _to_do(context, pipeline))
            with _step_errors(step.name), storage_errors():
                child = context.child(step.name, first_step=done)
                child.folder.mkdir(parents=True, exist_ok=True)
                if not _is_done(context, step.name):
                    with _timed(child), child.closing:
                        kinds[step.kind].run(child, step.config)
                    _finish(context, child, step)
                done += int(json.loads((child.folder / _DONE).read_bytes())["steps"])
    except Stopped:
        if context.cancelled():
            _cancel(kinds, context, _to_do(context, pipeline))
        raise
    except ServiceError:  # the run fails
        _cancel(kinds, context, _to_do(context, pipeline))
        raise


def _check_tasks(context: RunContext, steps: Sequence[Step]) -> None:
    """Checks that there are the tasks of all steps, with their conditions, before hours are spent on the first ones."""
    asked = [step for step in steps if getattr(step.config, "task", "")]
    if not asked:
        return
    sim = context.client("sim")
    tasks = context.retry().call(lambda: sim.list_tasks(ListTasksRequest()))
    for step in asked:
        with _step_errors(step.name):
            task = select_task(tasks, step.config.task, field="config.task")
            unknown = sorted({*getattr(step.config, "conditions", ())}.difference(task.conditions))
            if unknown:
                rule, hint = f"among those of {task.name}", f"It has {', '.join(task.conditions) or 'none'}."
                raise must_be("conditions", rule, quoted(unknown[0]), field="config.conditions", hint=hint)


def _begin(kinds: Mapping[Any, Kind[Any]], context: RunContext, steps: Sequence[Step]) -> None:
    """Begins the fits among steps to do whose turn may come later, once the steps that they come after are done."""
    for step in steps:
        remote = kinds[step.kind].remote
        if remote is not None and step.after and all(_is_done(context, name) for name in step.after):
            child = context.child(step.name, first_step=0)
            with _step_errors(step.name), storage_errors(), child.closing:
                remote.begin(child, step.config)


def _cancel(kinds: Mapping[Any, Kind[Any]], context: RunContext, steps: Sequence[Step]) -> None:
    """Cancels the fits that have begun, among steps that are not done, all at once: a service may not answer."""

    def cancel(step: Step, child: RunContext) -> None:
        remote = kinds[step.kind].remote
        if remote is not None:
            with child.closing:
                remote.cancel(child, step.config)

    fits = [step for step in steps if kinds[step.kind].remote is not None]
    children = [context.child(step.name, first_step=0) for step in fits]
    with ThreadPoolExecutor(max(1, len(fits)), thread_name_prefix="cancel") as pool:
        list(pool.map(cancel, fits, children))


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


def _check_after(steps: Sequence[StepConfig], remote: Sequence[str]) -> None:
    """Checks that only kinds with work of other services begin early, and only after earlier steps."""
    for place, step in enumerate(steps):
        if step.after and step.kind not in remote:
            raise InvalidInput(
                f"Only steps of the kinds {', '.join(remote)} may begin before their turn; {step.name} is another.",
                field="config.steps.after",
                hint="Leave `after` out: steps are done in order.",
            )
        if not set(step.after) <= {each.name for each in steps[:place]}:
            raise InvalidInput(
                f"`after` must name earlier steps; that of {step.name} names another.",
                field="config.steps.after",
                hint="Put the step below those that it comes after.",
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


def _to_do(context: RunContext, pipeline: Pipeline) -> list[Step]:
    return [step for step in pipeline.steps if not _is_done(context, step.name)]


def _is_done(context: RunContext, name: str) -> bool:
    return (context.folder / "parts" / name / _DONE).is_file()


@contextmanager
def _timed(child: RunContext) -> Iterator[None]:
    """Adds the duration of an attempt to the step's seconds, however it ends."""
    started_s = time.monotonic()
    try:
        yield
    finally:
        seconds = _seconds(child) + time.monotonic() - started_s
        with suppress(OSError):  # the attempt's own end is what matters
            write_atomic(child.folder / _SECONDS, json.dumps(seconds).encode())


def _seconds(child: RunContext) -> float:
    path = child.folder / _SECONDS
    return float(json.loads(path.read_bytes())) if path.is_file() else 0.0


def _finish(context: RunContext, child: RunContext, step: Step) -> None:
    """Links a step's artifacts into the run's, and records that it is done."""
    for artifact in child.artifacts.iterdir():
        link = context.artifacts / f"{step.name}.{artifact.name}"
        link.unlink(missing_ok=True)
        os.link(artifact, link)
    fsync_folder(context.artifacts)
    steps = max(0, last_step(context.run_folder) - child.first_step)
    row = {"name": step.name, "kind": step.kind, "steps": steps, "seconds": _seconds(child)}
    path = context.artifacts / STEPS
    rows = json.loads(path.read_bytes()) if path.is_file() else []
    write_atomic(path, json.dumps([*(each for each in rows if each["name"] != step.name), row], indent=2).encode())
    write_atomic(child.folder / _DONE, json.dumps(row).encode())
