"""A kind of run."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from freerein_orchestrator.kinds.context import RunContext
from freerein_orchestrator.kinds.policy_store import PolicyStore

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

C = TypeVar("C", bound="DataclassInstance")


@dataclass(frozen=True)
class RemoteWork(Generic[C]):
    """Work of another service, which `Kind.run` follows to its end.

    Attributes:
        begin: Starts it, unless it was started already, and returns at once.
        cancel: Cancels it, if it was started.
    """

    begin: Callable[[RunContext, C], None]
    cancel: Callable[[RunContext, C], None]


@dataclass(frozen=True)
class Kind(Generic[C]):
    """A kind of run, with a configuration of class C.

    Attributes:
        configs: Dataclass of each form of its configurations; of the form `""` where there is one alone.
        parse: Returns the configuration of JSON values, defaults filled in; raises InvalidInput.
        steps: Returns the number of steps of a run.
        run: Does the work, or resumes it. Raises `Stopped` once the context says so; a `ServiceError` fails the run.
        check: Before a run is queued, raises InvalidInput if it builds on what does not exist or does not fit. Given
            the stored policies and runs, and the kinds of earlier steps of the same pipeline by name. Calls no service.
        dump: Returns a configuration as JSON values that `parse` reads.
        truth: Returns the privileged data that a run reads, itself or by a policy that it builds on, and their purpose;
            empty for none. It gets the configuration as it was dumped, maybe by an earlier version, and the stored
            policies and runs.
        remote: What another service does for it, which may begin before `run`; None if the run does all itself.
        meaning: Description of a run in a sentence, for people who choose a kind.
    """

    configs: Mapping[str, type]
    parse: Callable[[Mapping[str, Any]], C]
    steps: Callable[[C], int]
    run: Callable[[RunContext, C], None]
    check: Callable[[C, PolicyStore, Mapping[str, str]], None] = lambda _config, _store, _earlier: None
    dump: Callable[[C], dict[str, Any]] = asdict
    truth: Callable[[Mapping[str, Any], PolicyStore], str] = lambda _config, _store: ""
    remote: RemoteWork[C] | None = None
    meaning: str = ""
