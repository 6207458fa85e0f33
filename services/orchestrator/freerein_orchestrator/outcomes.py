"""How attempts at runs end, and where runs stand."""

from dataclasses import dataclass
from typing import Literal

from freerein.types.orchestrator import RunState

Reason = Literal["", "leave", "cancel"]
"""Why an attempt is to stop: another one will go on with the run, or the run was cancelled; empty while it goes on."""

CANCELLED = "cancelled"
"""A file in a run's folder, there when its child is told to stop because the run was cancelled."""

A_BUG = "A bug of ours; the log says more."
"""Why a run failed, where nothing better is known."""


@dataclass(frozen=True)
class Attempt:
    """How an attempt at a run ended.

    Attributes:
        outcome: `succeeded` and `failed` end the run; after `crashed` it is tried again.
        progressed: Whether it got further than the attempts before it.
        reason: Why it failed or crashed.
    """

    outcome: Literal["succeeded", "failed", "crashed"]
    progressed: bool = False
    reason: str = ""


@dataclass(frozen=True)
class Standing:
    """Where a run stands, as the database has it.

    Attributes:
        state: Where it stands.
        reason: Why it failed, else empty.
    """

    state: RunState
    reason: str = ""


class Interrupted(BaseException):
    """Ends an attempt that was told to stop, with nothing recorded, so that it is made again if the run goes on.

    No Exception, because DBOS records those as the end of the run.
    """
