"""What a kind of run is."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any

from freerein_orchestrator.work import Work


@dataclass(frozen=True)
class Kind:
    """A kind of run.

    Attributes:
        resolve: Returns the whole configuration for a partial one, defaults filled in; raises InvalidInput for what
            cannot be. It asks no service.
        steps: Returns how many steps a run of a whole configuration takes.
        run: Does the work, or goes on with it, and returns True; saves and returns False once `stop` says so. A
            `ServiceError` that it raises ends the run; what trying again may mend it waits for itself.
        check: Before a run of a whole configuration is queued, raises InvalidInput where it builds on what is not there
            or does not fit. Given the work, whose folder is not made yet, and the names of what will be there by
            then: the earlier steps of the same pipeline. It asks no service.
    """

    resolve: Callable[[Mapping[str, Any]], dict[str, Any]]
    steps: Callable[[Mapping[str, Any]], int]
    run: Callable[[Work], bool]
    check: Callable[[Work, Collection[str]], None] = lambda _work, _earlier: None
