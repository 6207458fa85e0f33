"""Locks that tell which workers are alive: each holds the lock of its name, freed by the kernel or Postgres."""

import fcntl
import os
from pathlib import Path

import psycopg

from freerein_orchestrator.runs.database_errors import check_encoding

_NAMESPACE = 1718641001  # of our advisory locks, in a database that others may use
_KEEPALIVES = "SET tcp_keepalives_idle = 5; SET tcp_keepalives_interval = 5; SET tcp_keepalives_count = 2"


class FileLocks:
    """Locks of workers on one machine: one file `<worker>.lock` each.

    Args:
        folder: Folder of the files.
    """

    predecessor_s = 2.0
    """Time in which a predecessor of the same name ends and its lock is free."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._held: dict[str, int] = {}

    def take(self, worker: str) -> bool:
        """Takes a worker's lock unless it is held; returns whether this process holds it now."""
        if worker in self._held:
            return True
        descriptor = os.open(self._folder / f"{worker}.lock", os.O_RDWR | os.O_CREAT, 0o644)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(descriptor)
            return False
        self._held[worker] = descriptor
        return True

    def free(self, worker: str) -> None:
        """Frees a lock that this process holds."""
        os.close(self._held.pop(worker))

    def close(self) -> None:
        """Frees all locks that this process holds."""
        for worker in tuple(self._held):
            self.free(worker)


class PostgresLocks:
    """Locks of workers on several machines: advisory locks of one connection, freed when it ends.

    Args:
        url: URL of the database, `postgresql://...`.
    """

    predecessor_s = 20.0
    """As of `FileLocks`, also where its machine was lost: Postgres notices that within 15 s."""

    def __init__(self, url: str) -> None:
        self._url = url
        self._held: set[str] = set()
        self._connection: psycopg.Connection[tuple[bool]] | None = None

    def take(self, worker: str) -> bool:
        """Takes a worker's lock unless it is held; returns whether this process holds it now.

        Raises:
            psycopg.OperationalError: The database is out of reach; all locks are lost.
            FailedPrecondition: The database has another encoding than UTF8.
        """
        try:
            connection = self._connect()
            if worker in self._held:
                connection.execute("SELECT 1")
            elif self._ask(connection, "SELECT pg_try_advisory_lock(%s, hashtext(%s))", worker):
                self._held.add(worker)
        except psycopg.OperationalError:
            self.close()
            raise
        return worker in self._held

    def free(self, worker: str) -> None:
        """Frees a lock that this process holds."""
        self._held.remove(worker)
        self._ask(self._connect(), "SELECT pg_advisory_unlock(%s, hashtext(%s))", worker)

    def close(self) -> None:
        """Frees all locks that this process holds."""
        self._held.clear()
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def _connect(self) -> "psycopg.Connection[tuple[bool]]":
        if self._connection is None:
            self._connection = psycopg.connect(self._url, autocommit=True)
            check_encoding(self._connection.info.parameter_status("server_encoding"))
            self._connection.execute(_KEEPALIVES)
        return self._connection

    @staticmethod
    def _ask(connection: "psycopg.Connection[tuple[bool]]", query: str, worker: str) -> bool:
        row = connection.execute(query, (_NAMESPACE, worker)).fetchone()
        return row is not None and row[0]
