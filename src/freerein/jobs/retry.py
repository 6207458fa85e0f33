"""Retry policy of jobs: three crashes without progress end one, or ten kills, each of which delays the next."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

_MAX_CRASHES, _MAX_KILLS = 3, 10
_FIRST_PAUSE_S, _MAX_PAUSE_S = 0.5, 60.0


@dataclass(frozen=True)
class AttemptResult:
    """Outcome of an attempt.

    Attributes:
        outcome: `succeeded` and `failed` end the job. After `crashed`, by a fault of its own, and `killed`, by a signal
            from outside or before it began, by a machine short of memory or files, it is attempted again.
        progressed: Whether the attempt did steps that no attempt before it had done.
        error: Why it did not succeed, in sentences; empty when it did.
    """

    outcome: Literal["succeeded", "failed", "crashed", "killed"]
    progressed: bool = False
    error: str = ""


@dataclass(frozen=True)
class Pause:
    """The wait before an attempt, in seconds, and its reason in a sentence."""

    seconds: float = 0.0
    reason: str = ""


NO_PAUSE = Pause()


def retry(attempt: Callable[[Pause], AttemptResult]) -> AttemptResult:
    """Makes attempts at a job until one ends it, or three crash or ten are killed since the last progress.

    More kills than crashes are allowed: an operator, or a machine without memory, says little about the job. After each
    kill in a row without progress the pause before the next attempt doubles, up to a minute. The job holds its place
    meanwhile, so that kills must end it, too: after three minutes of pauses.
    """
    crashes, kills, pause = 0, 0, NO_PAUSE
    while True:
        result = attempt(pause)
        if result.outcome in ("succeeded", "failed"):
            return result
        crashes = 0 if result.progressed else crashes + (result.outcome == "crashed")
        kills = 0 if result.progressed else kills + (result.outcome == "killed")
        if crashes >= _MAX_CRASHES or kills >= _MAX_KILLS:
            ended = f"{crashes + kills} attempts in a row ended without progress"
            return AttemptResult("failed", error=f"{ended}. {result.error}")
        pause_s = min(max(2 * pause.seconds, _FIRST_PAUSE_S), _MAX_PAUSE_S)
        pause = NO_PAUSE if result.progressed or result.outcome == "crashed" else Pause(pause_s, result.error)
