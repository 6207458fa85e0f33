"""How attempts at runs end."""

from dataclasses import dataclass
from typing import Literal

Reason = Literal["", "leave", "cancel"]
"""Why an attempt is to stop: another one will go on with the run, or the run was cancelled; empty while it goes on."""

CANCELLED = "cancelled"
"""A file in a run's folder, there when its child is told to stop because the run was cancelled."""


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


class Interrupted(BaseException):
    """Ends an attempt that was told to stop, with nothing recorded, so that it is made again if the run goes on.

    No Exception, because DBOS records those as the end of the run.
    """
