"""`freerein run`: starts a run; `freerein jobs` does all else."""

from pathlib import Path
from typing import Annotated

import typer

from freerein.cli.commands.jobs import Watch, show_or_watch
from freerein.cli.connection import call
from freerein.cli.jobs.config_keys import KeysHelp
from freerein.cli.jobs.options import Settings, configuration
from freerein.cli.output import AsJson, command
from freerein.clients import OrchestratorClient
from freerein.types.orchestrator import StartRunRequest

app = typer.Typer(add_completion=False)


_Kind = Annotated[
    str, typer.Argument(metavar="KIND", help="collect, fit, label, ppo, distill, evaluate, pipeline, skills, zsrm.")
]
_Config = Annotated[Path | None, typer.Option(metavar="FILE.json", help="Configuration file; --set overrides it.")]
_Key = Annotated[str, typer.Option(help="Idempotency key: the same key and configuration is the same run.")]


@app.command(cls=KeysHelp)
@command
def run(
    kind: _Kind,
    *,
    settings: Settings = None,
    config: _Config = None,
    key: _Key = "",
    watch: Watch = False,
    as_json: AsJson = False,
) -> None:
    """Start a run, which survives crashes: collect, fit, label, ppo, distill, evaluate, pipeline, skills, zsrm.

    `freerein run KIND --help` has the keys of one kind.
    """
    request = StartRunRequest(kind, configuration(kind, settings, config), key)
    started = call(OrchestratorClient, "orchestrator", lambda client: client.start_run(request)).run
    show_or_watch("orchestrator", started, watch=watch, as_json=as_json)
