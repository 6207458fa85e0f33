"""Why the database of the runs refuses, as errors that callers and operators can act on."""

import os
import sqlite3

from psycopg.errors import DiskFull

from freerein.atomic_files import OUT_OF_FILES, out_of_files, out_of_storage
from freerein.errors import FailedPrecondition, ServiceError, Unavailable

_ENCODING = "UTF8"
_SQLITE_STORAGE = {sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR, sqlite3.SQLITE_READONLY}


def database_error(error: Exception) -> ServiceError:
    """Returns `OutOfStorage` when the disk of the database refuses, else `Unavailable`.

    `error` is of a driver, or SQLAlchemy's around it.
    """
    cause = getattr(error, "orig", error)
    if isinstance(cause, DiskFull):
        return out_of_storage("the disk of Postgres is full")
    code = getattr(cause, "sqlite_errorcode", 0) & 0xFF  # the last byte; the rest says more
    if code in _SQLITE_STORAGE:
        return out_of_storage(str(cause))
    if code == sqlite3.SQLITE_CANTOPEN:  # SQLite does not say why
        return out_of_files() if _is_out_of_files() else out_of_storage(str(cause))
    return unreachable()


def unreachable() -> Unavailable:
    """Returns the error of a database that does not answer."""
    return Unavailable(
        "The database of the runs must be reachable; it does not answer, or refuses the login.",
        hint="Start it, create the database, or set FREEREIN_DATABASE_URL.",
        retry_after_s=1.0,
    )


def _is_out_of_files() -> bool:
    """Returns whether this process may open no more files."""
    try:
        os.close(os.open(os.devnull, os.O_RDONLY))
    except OSError as error:
        return error.errno in OUT_OF_FILES
    return False


def check_encoding(encoding: str | None) -> None:
    """Raises FailedPrecondition unless a Postgres database has the encoding that every text can be stored in."""
    if encoding != _ENCODING:
        raise FailedPrecondition(
            f"The Postgres database of the runs must have the encoding {_ENCODING}; it has {encoding}.",
            hint="Create one with CREATE DATABASE runs ENCODING 'UTF8' TEMPLATE template0, and name it in "
            "FREEREIN_DATABASE_URL.",
        )
