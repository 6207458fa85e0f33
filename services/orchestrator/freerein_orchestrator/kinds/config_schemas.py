"""JSON schemas of the configurations of runs."""

from typing import Any

from freerein.config_schema import config_schema
from freerein_orchestrator.kinds import KINDS


def run_config_schema() -> dict[str, Any]:
    """Returns the JSON schema of `config` of a run; its alternatives are called as their kinds, and forms, are."""
    schemas = [
        {**config_schema(config, title=" ".join(filter(None, (name, form)))), "description": kind.meaning}
        for name, kind in sorted(KINDS.items())
        for form, config in kind.configs.items()
    ]
    return {"anyOf": schemas}
