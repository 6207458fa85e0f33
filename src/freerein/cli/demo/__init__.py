"""`freerein demo`: what the models that come with freerein can do, then two that are learned."""

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
    """Show what freerein does, in three to five minutes: four results of its models, then two that are learned.

    Writes pictures, summary.json and summary.md. The exit code is 1 when a part fails.
    """
    asyncio.run(run(out, seed=seed, reporter=Reporter(is_quiet=as_json), running=running))
