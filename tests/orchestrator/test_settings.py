"""Settings of the orchestrator that cannot be used are refused, in words that hold no password."""

import pytest
from pydantic import SecretStr, ValidationError

from freerein_orchestrator.settings import OrchestratorSettings


@pytest.mark.fault("C20")
@pytest.mark.parametrize(
    "url",
    [
        "secret",
        "mysql://user:secret@host/runs",
        "sqlite:///secret",
        "postgresql+asyncpg://user:secret@host/runs",
        "postgresql://user:secret@host:port/runs",
        "postgresql://user:secret@host:65536/runs",
        "postgresql://user:secret@[::1/runs",
        "postgresql://user:secret@host/runs?unknown=1",
        "host=localhost password=secret",
    ],
)
def test_a_database_url_that_is_not_of_postgres_is_refused(url: str) -> None:
    with pytest.raises(ValidationError) as error:
        OrchestratorSettings(database_url=SecretStr(url))
    (found,) = error.value.errors()
    assert "FREEREIN_DATABASE_URL must be a URL of Postgres" in found["msg"]
    assert "secret" not in str(error.value)


@pytest.mark.parametrize("url", ["postgresql://user:p%40ss@host:5432/runs", "postgres://host/runs?sslmode=require"])
def test_a_url_of_postgres_is_taken(url: str) -> None:
    assert OrchestratorSettings(database_url=SecretStr(url)).database_url == SecretStr(url)
