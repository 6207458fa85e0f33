"""Settings from the environment, in the spellings that people use."""

from pathlib import Path
from types import MappingProxyType
from typing import Any, get_args

from pydantic import ValidationInfo, field_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

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

    model_config = SettingsConfigDict(env_prefix="FREEREIN_", frozen=True, env_ignore_empty=True)

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
        if name == "host":
            return unbracketed(value)
        return _WORDS[name].get(value.lower(), value.lower()) if name in _WORDS else value


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
