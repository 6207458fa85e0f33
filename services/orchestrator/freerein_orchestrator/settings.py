"""The operator's settings of the orchestrator."""

from typing import Self

from psycopg import ProgrammingError
from psycopg.conninfo import conninfo_to_dict
from pydantic import Field, SecretStr, model_validator

from freerein.serving.settings import ServiceSettings


class OrchestratorSettings(ServiceSettings):
    """Settings of the orchestrator.

    Attributes:
        database_url: Postgres, `postgresql://user:password@host/database`, whose queue several workers may share; unset
            for SQLite in the data directory.
        executor_id: The worker's name: the same at every start, and no other's.
        device: Where policies are trained: `auto`, `cpu` or `cuda:N`.
    """

    database_url: SecretStr | None = None
    executor_id: str = Field(default="worker", pattern=r"^[a-z0-9][a-z0-9._-]{0,63}$")
    device: str = Field(default="auto", pattern=r"^(auto|cpu|cuda:\d+)$")

    @model_validator(mode="after")
    def _check_database_url(self) -> Self:
        if self.database_url and not _is_of_postgres(self.database_url.get_secret_value()):
            raise ValueError(
                "FREEREIN_DATABASE_URL must be a URL of Postgres, postgresql://user:password@host:5432/database, with "
                "@, / and : of a password as %40, %2F and %3A, and without the name of a driver; "
                "got another text, which is not shown, since it may hold a password"
            )
        return self


def _is_of_postgres(url: str) -> bool:
    scheme, _, _ = url.partition("://")
    try:
        port = int(conninfo_to_dict(url).get("port") or 5432)
    except (ProgrammingError, ValueError):
        return False
    return scheme.lower() in ("postgresql", "postgres") and 0 < port <= 65535
