"""How attempts at runs end."""

from dataclasses import dataclass
from typing import Literal


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
