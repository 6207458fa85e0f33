"""Settings from the environment, in the spellings that people use; unknown names are refused."""

import os
import re
from collections.abc import Iterator, Mapping
from difflib import SequenceMatcher
from pathlib import Path
from types import MappingProxyType
from typing import Any, Self, get_args

from pydantic import ValidationError, ValidationInfo, field_validator, model_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

from freerein.ports import PORTS
from freerein.unknown_names import nearest, quoted_name

OURS = "FREEREIN"
"""The prefix of all variables, before `_`."""
KNOWN = (
    *[
        "TOKEN",
        "TLS_CERT",
        "TLS_KEY",
        "HOST",
        "HTTP_PORT",
        "GRPC_PORT",
        "PORT_BASE",
        "INSECURE",
        "LOG_LEVEL",
        "DATA_DIR",
        "RECEIPT_S",
        "WRITE_S",
    ],
    *["IDLE_S", "KEEP_ALIVE_S", "PING_S", "DRAIN_DELAY_S", "UNARY_S", "QUEUE", "CORS_ORIGINS"],
    *["DEVICE", "TRAIN_THREADS", "SHIPPED_DIR", "GOAL_CACHE_BYTES", "SIM_WORKERS", "SIM_SESSIONS", "SIM_ENVS"],
    *["DATABASE_URL", "EXECUTOR_ID"],
    *(f"{name.upper()}_{kind}" for name in PORTS for kind in ("ADDRESS", "URL")),
    *["MEMORY", "ROBOTS"],  # of compose
    *["FUZZ", "SOAK_MINUTES", "TESTS_FORK_SERVER"],  # of tests
)
"""Names after `FREEREIN_` of all variables, of all services: what one does not use, another does."""

_OF_CONTAINERS = re.compile(r"\w+_(SERVICE_(HOST|PORT)(_\w+)?|PORT_\d+_(TCP|UDP|SCTP)(_\w+)?|ENV_\w+)")
_CLOSE = 0.75  # 0 to 1, of a prefix to ours

_WORDS = MappingProxyType(
    {
        "log_level": {"warn": "warning", "critical": "error", "fatal": "error"},
        "device": {"cuda": "cuda:0", "gpu": "cuda:0"},
    }
)
"""Settings that are words, whatever their case, and other words for them."""


class EnvironmentVariables(BaseSettings):
    """Settings, each an environment variable `FREEREIN_<NAME>`.

    Spaces around a value do not matter; `~` in a path is the home directory, and an IPv6 address may be in brackets.
    """

    model_config = SettingsConfigDict(env_prefix=f"{OURS}_", frozen=True, env_ignore_empty=True)

    @model_validator(mode="after")
    def _check_names(self) -> Self:
        unknown = list(unknown_variables(os.environ))
        if unknown:
            raise ValueError(f"environment variables of freerein must be known; got {' and '.join(unknown)}")
        return self

    @field_validator("*", mode="before")
    @classmethod
    def _spelled(cls, value: Any, info: ValidationInfo) -> Any:
        name = str(info.field_name)
        annotation = cls.model_fields[name].annotation
        kinds = get_args(annotation) or (annotation,)
        if Path in kinds and isinstance(value, str | Path):
            return expanded(str(value))
        if not isinstance(value, str) or (not {str, int, float, bool}.intersection(kinds) and name not in _WORDS):
            return value
        value = value.strip()
        if name.endswith("_port") and is_container_link(value):
            return cls.model_fields[name].default
        if name == "host":
            return unbracketed(value)
        return _WORDS[name].get(value.lower(), value.lower()) if name in _WORDS else value


def unknown_variables(environ: Mapping[str, str]) -> Iterator[str]:
    """Yields the name of each variable of our prefix that is no setting, and the one that was probably meant.

    Those that Kubernetes and Docker set in containers may be.
    """
    for variable, value in environ.items():
        prefix, _, name = variable.upper().partition("_")
        if not value or (prefix == OURS and name in KNOWN) or _is_of_containers(variable, value):
            continue
        if prefix.startswith(OURS) or (name in KNOWN and SequenceMatcher(None, prefix, OURS).ratio() >= _CLOSE):
            name = name or prefix.removeprefix(OURS)
            meant = nearest(name, KNOWN) or next((each for each in KNOWN if name in each.split("_")), "")
            yield f"{quoted_name(variable)}{f', did you mean `{OURS}_{meant}`?' if meant else ', which is unknown'}"


def is_container_link(port: str) -> bool:
    """Returns whether Kubernetes or Docker has set a port: `FREEREIN_HTTP_PORT` of a service called `freerein-http`."""
    return port.startswith(("tcp://", "udp://", "sctp://"))


def _is_of_containers(variable: str, value: str) -> bool:
    return (
        bool(_OF_CONTAINERS.fullmatch(variable))
        or (variable.endswith("_PORT") and is_container_link(value))
        or (variable.endswith("_NAME") and value.startswith("/"))
    )


def reasons(error: ValidationError) -> str:
    """Returns the errors of settings, by their variables, without their values."""
    found = [("_".join(map(str, each["loc"])).upper(), each["msg"]) for each in error.errors()]
    return "; ".join(f"{OURS}_{name}: {text}" if name else text.removeprefix("Value error, ") for name, text in found)


def expanded(path: str) -> Path:
    """Returns a path without spaces around it, and with the home directory for `~`; ValueError where there is none."""
    try:
        return Path(path.strip()).expanduser()
    except RuntimeError:
        raise ValueError("begins with `~` and the name of no user of this machine") from None


def unbracketed(host: str) -> str:
    """Returns a host without the spaces and brackets around it."""
    host = host.strip()
    return host[1:-1] if host.startswith("[") and host.endswith("]") else host
