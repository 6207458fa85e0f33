"""Settings of every service, read once from the environment by `__main__`."""

import re
import ssl
from pathlib import Path
from typing import Literal, Self

from pydantic import Field, SecretStr, model_validator

from freerein.errors import FailedPrecondition
from freerein.ports import MAX_PORT_BASE
from freerein.serving.environment import EnvironmentVariables

_LOOPBACK = ("127.0.0.1", "::1", "localhost")
_TOKEN = re.compile(r"[!-~]+")  # what a header carries unchanged
_ORIGIN = re.compile(r"https?://[^/\s?#*]+")


class ServiceSettings(EnvironmentVariables):
    """Settings of every service. Each is an environment variable `FREEREIN_<NAME>`.

    Attributes:
        host: Address to bind.
        http_port: Port of the REST API; 0 for a free one, unset for the service's own: orchestrator 8100, segmentation
            8101, imitation 8102, reward 8103, sim 8104.
        grpc_port: Port of the gRPC server; 0 for a free one, unset for the service's own: 9100 to 9104 in that order.
        port_base: Where default ports begin: REST ports are the five from it on, gRPC ports those 1000 above.
        token: Bearer token that every call except health checks and the page `/docs` must carry, printable ASCII
            without spaces; unset for none.
        tls_cert: PEM file with the certificate chain; with `tls_key`, REST and gRPC use TLS.
        tls_key: PEM file with the private key.
        insecure: Allows a bind beyond loopback without token and TLS.
        log_level: Least level of the lines of the log; `debug` has unary calls that succeed, too.
        data_dir: Folder of datasets, models, fits and runs.
        receipt_s: Seconds that a client has to send a whole request, or a whole message of a WebSocket.
        write_s: Seconds that a client may leave a reply unread.
        idle_s: Seconds that a robot's WebSocket may be open without a message.
        keep_alive_s: Seconds that an HTTP connection may be open without a request after the first.
        ping_s: Seconds between two pings of a robot's WebSocket, and from a ping until anything arrives.
        drain_delay_s: Seconds after SIGTERM in which the service is not ready but answers as before, for load balancers
            to notice.
        unary_s: Seconds from request to reply of a unary call; a model call of four times as long ends the process.
        queue: Items that may wait for the model.
        cors_origins: Origins whose web pages may call the REST API, separated by commas, such as
            `http://localhost:3000`; unset for none.
    """

    host: str = "127.0.0.1"
    http_port: int | None = Field(default=None, ge=0, le=65535)
    grpc_port: int | None = Field(default=None, ge=0, le=65535)
    port_base: int = Field(default=8100, ge=1, le=MAX_PORT_BASE)
    token: SecretStr | None = None
    tls_cert: Path | None = None
    tls_key: Path | None = None
    insecure: bool = False
    log_level: Literal["debug", "info", "warning", "error"] = "info"
    data_dir: Path = Path("var")
    receipt_s: float = Field(default=10.0, gt=0, le=600)
    write_s: float = Field(default=30.0, gt=0, le=600)
    idle_s: float = Field(default=600.0, gt=0, le=86400)
    keep_alive_s: float = Field(default=75.0, gt=0, le=86400)
    ping_s: float = Field(default=10.0, gt=0, le=3600)
    drain_delay_s: float = Field(default=0.0, ge=0, le=600)
    unary_s: float = Field(default=30.0, gt=0, le=3600)
    queue: int = Field(default=256, ge=1, le=65536)
    cors_origins: str = ""

    @model_validator(mode="after")
    def _check_exposure(self) -> Self:
        if (self.tls_cert is None) != (self.tls_key is None):
            raise ValueError("FREEREIN_TLS_CERT and FREEREIN_TLS_KEY must be set together")
        if self.host not in _LOOPBACK and not (self.token or self.tls_cert or self.insecure):
            raise ValueError(
                "a bind beyond loopback needs FREEREIN_TOKEN or FREEREIN_TLS_CERT and FREEREIN_TLS_KEY; "
                "set FREEREIN_INSECURE=1 to serve without either on a trusted network"
            )
        return self

    @model_validator(mode="after")
    def _check_token(self) -> Self:
        if self.token and not _TOKEN.fullmatch(self.token_text):
            raise ValueError(
                "FREEREIN_TOKEN must be printable ASCII without spaces, so that a header can carry it; it has other "
                "characters. Make one with: openssl rand -hex 32"
            )
        return self

    @model_validator(mode="after")
    def _check_files(self) -> Self:
        if self.data_dir.exists() and not self.data_dir.is_dir():
            raise ValueError("FREEREIN_DATA_DIR must be a folder, or not exist yet; it is a file")
        if self.tls_cert is not None and self.tls_key is not None:
            try:
                ssl.create_default_context(ssl.Purpose.CLIENT_AUTH).load_cert_chain(
                    self.tls_cert, self.tls_key, password=""
                )
            except OSError:
                raise ValueError(
                    "FREEREIN_TLS_CERT and FREEREIN_TLS_KEY must be readable PEM files that belong together, "
                    "the key without a password"
                ) from None
        return self

    @model_validator(mode="after")
    def _check_origins(self) -> Self:
        if not all(_ORIGIN.fullmatch(origin) for origin in self.origins):
            raise ValueError(
                "FREEREIN_CORS_ORIGINS must be origins separated by commas, each a scheme, a host and perhaps a port "
                "without a path, such as https://robots.example:8443"
            )
        return self

    def make_data_dir(self) -> None:
        """Makes the data directory. Raises FailedPrecondition where it is not there and cannot be made."""
        try:
            self.data_dir.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise FailedPrecondition(
                f"FREEREIN_DATA_DIR must be a folder, or one that can be made; it is missing, and: {error.strerror}.",
                hint="Set it to a folder that the service may write.",
            ) from None

    @property
    def origins(self) -> tuple[str, ...]:
        """Origins whose web pages may call the REST API."""
        origins = (origin.strip().removesuffix("/") for origin in self.cors_origins.split(","))
        return tuple(filter(None, origins))

    @property
    def is_local(self) -> bool:
        """Whether only this machine is to call it: it is on loopback, without token and TLS."""
        return self.host in _LOOPBACK and not (self.token or self.tls_cert)

    @property
    def token_text(self) -> str:
        """The token, empty for none."""
        return self.token.get_secret_value() if self.token else ""
