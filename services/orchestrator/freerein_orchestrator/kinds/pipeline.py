"""Kind `pipeline`: runs of other kinds, one after the other, each as a part of one run.

<folder>/parts/<step>/           what would be the folder of a run of its own
         parts/<step>/done.json  how many steps it made, once it is done: it is not done again
         artifacts/<step>.<name> the artifacts of the parts that are done
"""

import json
import os
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import Any

from freerein.atomic_files import fsync_folder, write_atomic
from freerein.errors import InvalidInput, ServiceError
from freerein.learning.config import parse
from freerein.types.common import check_name
from freerein.types.orchestrator import RunKind
from freerein_orchestrator.curve import last_step
from freerein_orchestrator.kinds.kind import Kind
from freerein_orchestrator.work import Work

_LONGEST_NAME = 24
"""Characters: the key of a step, and names of its artifacts, are no longer than names may be."""
_DONE = "done.json"


@dataclass(frozen=True)
class PipelineConfig:
    """What to do.

    Attributes:
        steps: In order, each an object; see `StepConfig`.
    """

    steps: tuple[dict[str, Any], ...]


@dataclass(frozen=True)
class StepConfig:
    """A step of a pipeline.

    Attributes:
        name: Its own; later steps may give it where a run's id is wanted.
        kind: What it does.
        config: The kind's configuration.
    """

    name: str
    kind: str
    config: dict[str, Any]


class Pipeline:
    """The kind, over the kinds that its steps may be of.

    Args:
        kinds: These.
    """

    def __init__(self, kinds: Mapping[RunKind, Kind]) -> None:
        self._kinds: Mapping[str, Kind] = dict(kinds.items())

    @property
    def kind(self) -> Kind:
        """The kind, as the others."""
        return Kind(self.resolve, self.steps, self.run, self.check)

    def resolve(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Returns the whole configuration, with the whole one of every step.

        Raises:
            InvalidInput: There is no step; two have one name; one is of a kind that there is not, or is wrong itself.
        """
        steps = [parse(StepConfig, step) for step in parse(PipelineConfig, values).steps]
        names = [_checked_name(step.name) for step in steps]
        if not steps or len(set(names)) < len(names):
            raise InvalidInput(
                f"A pipeline must have steps, and each a name of its own; got {len(names)} steps and "
                f"{len(set(names))} names.",
                field="config.steps",
                hint="Later steps name the earlier ones whose results they want.",
            )
        return {"steps": [{**asdict(step), "config": self._resolved(step)} for step in steps]}

    def steps(self, config: Mapping[str, Any]) -> int:
        """Returns the steps of all parts together."""
        return sum(self._kinds[step["kind"]].steps(step["config"]) for step in config["steps"])

    def check(self, work: Work, _earlier: Collection[str]) -> None:
        """Refuses a step that builds on what will not be there, such as a later step."""
        earlier: list[str] = []
        for step in map(_step, work.config["steps"]):
            with _named(step):
                self._kinds[step.kind].check(work.part(step.name, step.config, first_step=0), earlier)
            earlier.append(step.name)

    def run(self, work: Work) -> bool:
        """Does the steps that are not done.

        Raises:
            ServiceError: A step failed.
        """
        made = 0
        for step in map(_step, work.config["steps"]):
            part = work.part(step.name, step.config, first_step=made)
            part.folder.mkdir(parents=True, exist_ok=True)
            if not (part.folder / _DONE).is_file():
                with _named(step), part.closing:
                    if not self._kinds[step.kind].run(part):
                        return False
                _finish(work, part, step.name)
            made += int(json.loads((part.folder / _DONE).read_bytes())["steps"])
        return True

    def _resolved(self, step: StepConfig) -> dict[str, Any]:
        if step.kind not in self._kinds:
            raise InvalidInput(
                f"The kind of a step must be one of {', '.join(self._kinds)}; got another.",
                field="config.steps.kind",
                hint="A pipeline holds no other pipeline.",
            )
        with _named(step):
            return self._kinds[step.kind].resolve(step.config)


def _step(values: Mapping[str, Any]) -> StepConfig:
    return StepConfig(**values)


def _checked_name(name: str) -> str:
    if len(check_name(name, field="config.steps.name")) > _LONGEST_NAME:
        raise InvalidInput(
            f"The name of a step must have at most {_LONGEST_NAME} characters; got {len(name)}.",
            field="config.steps.name",
            hint="Choose a shorter one.",
        )
    return name


@contextmanager
def _named(step: StepConfig) -> Iterator[None]:
    """Says in errors which step they are about."""
    try:
        yield
    except ServiceError as error:
        raise type(error)(
            f"In step {step.name}: {error.detail}",
            field=error.field.replace("config", "config.steps.config", 1),
            hint=error.hint,
            retry_after_s=error.retry_after_s,
        ) from error


def _finish(work: Work, part: Work, name: str) -> None:
    """Shows a part's artifacts among those of the whole, and notes that it is done."""
    for artifact in part.artifacts.iterdir():
        shown = work.artifacts / f"{name}.{artifact.name}"
        shown.unlink(missing_ok=True)
        os.link(artifact, shown)
    fsync_folder(work.artifacts)
    made = max(0, last_step(work.run) - part.first_step)
    write_atomic(part.folder / _DONE, json.dumps({"steps": made}).encode())
