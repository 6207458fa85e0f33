"""Waiting for services that are away: they are asked again and again, after pauses with full jitter."""

import time
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from freerein.errors import DeadlineExceeded, ModelFault, Overloaded, ServiceError, Unavailable, WorkerLost

T = TypeVar("T")

AWAY: tuple[type[ServiceError], ...] = (Unavailable, DeadlineExceeded, WorkerLost, Overloaded)
"""What is raised when a service is away or has too much to do: trying again will help."""

_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.2, 5.0
_DOUBLINGS = 5
_LOOK_S = 0.1
_MODEL_FAULTS = 3


class Stopped(Exception):
    """The work was told to stop."""


class Patience:
    """Does what needs services, again until they are there, however long that takes.

    The pause before each further try is uniform up to a bound, which doubles ("full jitter", Brooker 2015).

    Args:
        rng: Draws how long to wait.
        stop: Whether the work is to stop; asked before each try and several times a second between two.
        say: Told, once for each absence, why there is waiting.
    """

    def __init__(self, rng: np.random.Generator, *, stop: Callable[[], bool], say: Callable[[str], None]) -> None:
        self._rng = rng
        self._stop = stop
        self._say = say
        self._failures = 0
        self._model_faults = 0

    def ask(self, do: Callable[[], T]) -> T:
        """Returns what `do` returns, once it does not raise that a service is away.

        Args:
            do: May be done several times.

        Raises:
            Stopped: The work was told to stop.
            ModelFault: A model failed three times.
            ServiceError: What else `do` raises.
        """
        while True:
            self.interrupt()
            try:
                done = do()
            except AWAY as away:
                self.wait(away)
            else:
                self.answered()
                return done

    def interrupt(self) -> None:
        """Does nothing unless the work is to stop.

        Raises:
            Stopped: It is.
        """
        if self._stop():
            raise Stopped

    def answered(self) -> None:
        """Takes note that a service is there: the next pause is a short one again."""
        self._failures = self._model_faults = 0

    def wait(self, away: ServiceError) -> None:
        """Returns when it is time to try again.

        Args:
            away: What the last try raised.

        Raises:
            Stopped: The work was told to stop.
            ModelFault: A model failed three times.
        """
        self._model_faults += isinstance(away, ModelFault)
        if self._model_faults == _MODEL_FAULTS:
            raise away
        if not self._failures:
            self._say(f"Waiting for a service. {away.detail}")
        pause_s = self._rng.uniform(0, min(_LONGEST_PAUSE_S, _FIRST_PAUSE_S * 2**self._failures))
        self._failures = min(self._failures + 1, _DOUBLINGS)
        until = time.monotonic() + pause_s
        while (left := until - time.monotonic()) > 0:
            self.interrupt()
            time.sleep(min(left, _LOOK_S))
