"""Rollouts over the network, whatever happens to the services meanwhile.

A rollout is the unit of recovery: when a service goes away, or a session is lost, new sessions are put where the
rollout began and it is collected again, by the same actor with the same draws. What comes of it is the same bits.
"""

from collections.abc import Callable, Sequence
from typing import TypeVar

from freerein.errors import (
    Cancelled,
    DeadlineExceeded,
    Internal,
    OutputNotFinite,
    Overloaded,
    ServiceError,
    SessionNotFound,
    StepOutOfOrder,
    Unavailable,
    WorkerLost,
)
from freerein_orchestrator.networks import ActorCritic
from freerein_orchestrator.patience import Patience
from freerein_orchestrator.ppo_config import PPOConfig
from freerein_orchestrator.ppo_training import Outset, roll_out
from freerein_orchestrator.rejection import Rejected
from freerein_orchestrator.rollout import Rollout
from freerein_orchestrator.served import ServedEnvironments

T = TypeVar("T")

_AWAY = (Unavailable, DeadlineExceeded, Overloaded, WorkerLost, Cancelled)
_LOST = (SessionNotFound, StepOutOfOrder)
"""The session is gone, or has not made the step that we believe it has."""


def persist(work: Callable[[], T], patience: Patience, *, on_failure: Callable[[], None] = lambda: None) -> T:
    """Returns what comes of work that needs services, begun anew until they are there all the while.

    Args:
        work: May be begun any number of times.
        patience: Waits in between.
        on_failure: Called whenever the work has failed.

    Raises:
        Rejected: A service answered nonsense, or has a bug.
        Stopped: The run is to stop.
        ServiceError: A service refused for good.
    """
    while True:
        try:
            result = work()
        except ServiceError as error:
            on_failure()
            if not is_passing(error):
                raise _final(error) from error
            patience.interrupt()  # a call that ends because we stop is no absence
            patience.wait(error)
        except BaseException:
            on_failure()
            raise
        else:
            patience.answered()
            return result


def is_passing(error: ServiceError) -> bool:
    """Returns whether an error is one of those that end when a service is back and sessions are made anew."""
    return isinstance(error, _AWAY + _LOST)


def _final(error: ServiceError) -> ServiceError:
    """Returns an error that is raised in the place of one that does not pass by itself."""
    if isinstance(error, Internal | OutputNotFinite):
        return Rejected(error.detail, hint=error.hint or "Look at the log of the service that answered so.")
    return error


class ServedRollouts:
    """Collects the rollouts of one training; for one thread.

    Args:
        open_at: Returns environments that stand where snapshots say.
        config: What was chosen.
        patience: Waits for services that are away.

    Attributes:
        recoveries: How often a rollout has been begun again.
    """

    def __init__(
        self, open_at: Callable[[Sequence[bytes]], ServedEnvironments], config: PPOConfig, patience: Patience
    ) -> None:
        self.recoveries = 0
        self._open_at = open_at
        self._config = config
        self._patience = patience
        self._environments: ServedEnvironments | None = None
        self._outset: Outset | None = None

    def gather(self, actor: ActorCritic, outset: Outset) -> tuple[Rollout, Outset]:
        """Returns the rollout of an actor from an outset on, and the outset of the next one.

        Raises:
            Rejected: A service answered nonsense, or has a bug.
            Stopped: The run is to stop.
            ServiceError: A service refused for good.
        """

        def roll() -> tuple[Rollout, Outset]:
            return roll_out(actor, outset, self._standing_at(outset), self._config)

        rollout, self._outset = persist(roll, self._patience, on_failure=self._fail)
        return rollout, self._outset

    def close(self) -> None:
        """Ends the sessions."""
        environments, self._environments, self._outset = self._environments, None, None
        if environments is not None:
            environments.close()

    def _fail(self) -> None:
        self.recoveries += 1
        self.close()

    def _standing_at(self, outset: Outset) -> ServedEnvironments:
        if self._environments is None or self._outset is not outset:
            self.close()
            self._environments = self._open_at(outset.environments)
        return self._environments
