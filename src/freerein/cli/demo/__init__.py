"""`freerein demo`: runs the whole pipeline on this machine and measures every stage."""

import asyncio
from pathlib import Path
from typing import Annotated

import typer

from freerein.cli.demo.report import Reporter
from freerein.cli.demo.run import run
from freerein.cli.output import AsJson, command

app = typer.Typer(add_completion=False)


@app.command()
@command
def demo(
    out: Annotated[Path, typer.Option(help="Output folder; the output of an earlier demo is deleted.")] = Path(
        "var/demo"
    ),
    seed: Annotated[int, typer.Option(min=0, help="Random seed.")] = 0,
    running: Annotated[
        bool, typer.Option("--running", help="Use the services that already run, and their data directory.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Run the whole pipeline, measure it, and draw the results.

    Writes summary.json, summary.md and the pictures. The exit code is 1 when a step fails. A figure that does not
    meet its bar is reported as "not met"; the exit code stays 0.
    """
    asyncio.run(run(out, seed=seed, reporter=Reporter(as_json=as_json), running=running))
