"""`freerein demo`: labels, rewards and policies learned, and measured, with everything that happens on screen."""

from pathlib import Path
from typing import Annotated

import typer

from freerein.cli.output import AsJson, verb


@verb
def demo(
    out: Annotated[
        Path, typer.Option(help="Folder for summary, pictures and data; an earlier demo's is emptied.")
    ] = Path("var/demo"),
    seed: Annotated[int, typer.Option(min=0, help="Seed of every draw.")] = 0,
    running: Annotated[
        bool, typer.Option("--running", help="Use the services that run already, and their data directory.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Run the whole pipeline on this machine, measure it, and draw what came out."""
    import asyncio

    from freerein.cli.demo.pipeline import run
    from freerein.cli.demo.screen import Screen

    asyncio.run(run(out, seed=seed, screen=Screen(as_json=as_json), running=running))
