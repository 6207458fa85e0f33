"""Settings of the command line, read from the environment by each command."""

from pathlib import Path

from pydantic import SecretStr, ValidationError

from freerein.errors import InvalidInput
from freerein.serving.environment import EnvironmentVariables, reasons


class CliSettings(EnvironmentVariables):
    """Settings of the command line: environment variables `FREEREIN_<NAME>`, shared with the services.

    Attributes:
        data_dir: Folder of datasets, models, fits, runs and logs.
        token: Bearer token sent to services; unset for none.
        tls_cert: PEM file of the root certificates of the services; unset for no TLS.
        shipped_dir: Folder of the shipped models; unset for `models/` of the clone.
    """

    data_dir: Path = Path("var")
    token: SecretStr | None = None
    tls_cert: Path | None = None
    shipped_dir: Path | None = None

    def __init__(self) -> None:
        """Reads the environment. Raises InvalidInput where a variable is wrong, or has the name of no setting."""
        try:
            super().__init__()
        except ValidationError as error:
            raise InvalidInput(
                f"The environment must hold settings: {reasons(error)}", hint="docs/configuration.md lists them all."
            ) from None

    @property
    def token_text(self) -> str:
        """The token; empty for none."""
        return self.token.get_secret_value() if self.token else ""
