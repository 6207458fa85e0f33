"""A session of the sim service that is open for as long as its environment is used."""

import threading
import uuid
import weakref
from contextlib import suppress
from dataclasses import replace

from freerein.clients import SyncClient
from freerein.errors import ServiceError
from freerein.types.sim import CloseSessionRequest, CreateSessionRequest, CreateSessionResponse

_CALL_S = 2.0


class LeasedSession:
    """A session, whose lease a thread renews even while a learner computes.

    It ends by `close`, by garbage collection, when the interpreter exits; and with its lease if the process dies.

    Args:
        sim: Client of the sim service, closed with the session.
        request: The session to create.

    Attributes:
        created: The service's reply.

    Raises:
        ServiceError: The service refused, was unreachable or did not answer in time.
    """

    def __init__(self, sim: SyncClient, request: CreateSessionRequest) -> None:
        keyed = replace(request, idempotency_key=uuid.uuid4().hex)
        self.created = sim.create_session(keyed)
        ended = threading.Event()
        self._thread = threading.Thread(
            target=_keep, args=(sim, keyed, self.created, ended), name="session-lease", daemon=True
        )
        self._thread.start()
        self._end = weakref.finalize(self, _end, ended, self._thread)

    def close(self) -> None:
        """Closes the session and the client; may be called twice."""
        self._end()
        self._thread.join()


def _keep(
    sim: SyncClient, request: CreateSessionRequest, created: CreateSessionResponse, ended: threading.Event
) -> None:
    """Renews the lease until `ended`, then closes the session."""
    session = created.session
    while session == created.session and not ended.wait(created.lease_s / 3):
        with suppress(ServiceError):  # the service may answer the next time
            session = sim.create_session(request, timeout_s=_CALL_S).session  # the same, unless it was lost
    with suppress(ServiceError):  # if this fails, the session ends with its lease
        sim.close_session(CloseSessionRequest(session), timeout_s=_CALL_S)
    ended.wait()
    sim.close()


def _end(ended: threading.Event, thread: threading.Thread) -> None:
    ended.set()
    if threading.current_thread() is threading.main_thread():  # else it may be the one that `thread` waits for
        thread.join()
