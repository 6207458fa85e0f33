"""What a kind of run is."""

from collections.abc import Callable, Mapping
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
    """

    resolve: Callable[[Mapping[str, Any]], dict[str, Any]]
    steps: Callable[[Mapping[str, Any]], int]
    run: Callable[[Work], bool]
