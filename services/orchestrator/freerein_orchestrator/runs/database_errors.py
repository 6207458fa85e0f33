"""Why the database of the runs refuses, as errors that callers and operators can act on."""

import sqlite3

from psycopg.errors import DiskFull

from freerein.atomic_files import out_of_storage
from freerein.errors import FailedPrecondition, ServiceError, Unavailable

_ENCODING = "UTF8"
_SQLITE_STORAGE = {sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR, sqlite3.SQLITE_READONLY}


def database_error(error: Exception) -> ServiceError:
    """Returns `OutOfStorage` when the disk of the database refuses to be written, else `Unavailable`.

    `error` is of a driver, or SQLAlchemy's around it.
    """
    cause = getattr(error, "orig", error)
    if isinstance(cause, DiskFull):
        return out_of_storage("the disk of Postgres is full")
    code = getattr(cause, "sqlite_errorcode", 0) & 0xFF  # the last byte; the rest says more
    if code in _SQLITE_STORAGE:
        return out_of_storage(str(cause))
    return _cannot_open() if code == sqlite3.SQLITE_CANTOPEN else unreachable()


def unreachable() -> Unavailable:
    """Returns the error of a database that does not answer."""
    return Unavailable(
        "The database of the runs must be reachable; it is not, or refuses the login.",
        hint="Start it, create the database, or set FREEREIN_DATABASE_URL.",
        retry_after_s=1.0,
    )


def _cannot_open() -> Unavailable:
    return Unavailable(
        "The process must be able to open the database of the runs; all file descriptors are in use, or its folder is "
        "missing or refuses.",
        hint="Raise its limit of open files, or give the service access to the data directory.",
    )


def check_encoding(encoding: str | None) -> None:
    """Raises FailedPrecondition unless a Postgres database has the encoding that every text can be stored in."""
    if encoding != _ENCODING:
        raise FailedPrecondition(
            f"The Postgres database of the runs must have the encoding {_ENCODING}; it has {encoding}.",
            hint="Create one with CREATE DATABASE runs ENCODING 'UTF8' TEMPLATE template0, and name it in "
            "FREEREIN_DATABASE_URL.",
        )
