"""What an operator may change of the orchestrator."""

from pydantic import Field, SecretStr

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
