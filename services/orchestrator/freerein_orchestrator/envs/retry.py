"""Retry with backoff: calls are repeated while a service is unavailable, for as long as it takes."""

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import TypeVar

import numpy as np

from freerein.errors import (
    Cancelled,
    DeadlineExceeded,
    Internal,
    ModelFault,
    OutputNotFinite,
    Overloaded,
    ServiceError,
    SessionNotFound,
    StepOutOfOrder,
    Unavailable,
    WorkerLost,
)
from freerein_orchestrator.rl.errors import IterationRejected, Stopped

T = TypeVar("T")

_FIRST_PAUSE_S, _MAX_PAUSE_S = 0.2, 5.0
_MAX_DOUBLINGS = 5
_POLL_S = 0.1
_MAX_MODEL_FAULTS = 3
_TRANSIENT = (Unavailable, DeadlineExceeded, Overloaded, WorkerLost, Cancelled, SessionNotFound, StepOutOfOrder)


def is_transient(error: ServiceError) -> bool:
    """Returns whether an error passes once the service is back and sessions are recreated."""
    return isinstance(error, _TRANSIENT)


class Retry:
    """Repeats work that needs services until it succeeds, with exponential backoff and full jitter (Brooker 2015).

    Args:
        rng: Draws the pauses.
        stop: Whether to stop; asked before each attempt and several times a second between attempts.
        tell: Called when an outage begins, with the reason for waiting, and when it ends, with an empty text.
    """

    def __init__(self, rng: np.random.Generator, *, stop: Callable[[], bool], tell: Callable[[str], None]) -> None:
        self._rng = rng
        self._stop = stop
        self._tell = tell
        self._failures = 0
        self._model_faults = 0

    def call(self, work: Callable[[], T]) -> T:
        """Returns the result of `work`, which may be called any number of times; raises as `attempts`."""
        for attempt in self.attempts():
            with attempt:
                result = work()
        return result

    def attempts(self, *, on_failure: Callable[[], None] = lambda: None) -> Iterator[AbstractContextManager[None]]:
        """Yields a context for each attempt at some work, until one of them ends without an error.

            for attempt in retry.attempts():
                with attempt:
                    result = work()

        Args:
            on_failure: Called after each failed attempt.

        Raises:
            Stopped: The work is to stop.
            IterationRejected: A service has a bug or returned non-finite numbers.
            ServiceError: A permanent failure, or a model that failed three times.
        """
        has_ended = False

        @contextmanager
        def attempt() -> Iterator[None]:
            nonlocal has_ended
            try:
                yield
            except ServiceError as error:
                on_failure()
                if not is_transient(error):
                    raise _to_permanent(error) from error
                self.wait(error)
            except BaseException:
                on_failure()
                raise
            else:
                self.reset()
                has_ended = True

        while not has_ended:
            self.interrupt()
            yield attempt()

    def interrupt(self) -> None:
        """Raises Stopped if the work is to stop."""
        if self._stop():
            raise Stopped

    def reset(self) -> None:
        """Starts the backoff anew: the service is available."""
        if self._failures:
            self._tell("")
        self._failures = self._model_faults = 0

    def wait(self, error: ServiceError) -> None:
        """Returns when it is time for the next attempt.

        Args:
            error: Why the last attempt failed.

        Raises:
            Stopped: The work is to stop.
            ModelFault: A model failed three times.
        """
        self.interrupt()  # a call may have failed because we stop
        self._model_faults += isinstance(error, ModelFault)
        if self._model_faults == _MAX_MODEL_FAULTS:
            raise error
        if not self._failures:
            self._tell(f"Waiting for a service. {error.detail}")
        pause_s = self._rng.uniform(0, min(_MAX_PAUSE_S, _FIRST_PAUSE_S * 2**self._failures))
        self._failures = min(self._failures + 1, _MAX_DOUBLINGS)
        until_s = time.monotonic() + pause_s
        while (left_s := until_s - time.monotonic()) > 0:
            self.interrupt()
            time.sleep(min(left_s, _POLL_S))


def _to_permanent(error: ServiceError) -> ServiceError:
    if isinstance(error, Internal | OutputNotFinite):
        return IterationRejected(error.detail, hint=error.hint or "See the log of the service that failed.")
    return error
