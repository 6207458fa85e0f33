"""`freerein`: the command line."""

import typer

from freerein.cli.commands import act, dataset, fit, models, reward, runs, segment, sim, up
from freerein.cli.demo import demo
from freerein.cli.doctor import doctor

app = typer.Typer(
    help="Serve learned robot skills. `freerein demo` shows everything; `freerein doctor` checks the machine.",
    epilog="Exit codes: 0 success, 1 error, 2 invalid command line, 130 Ctrl-C (0 for `up`).",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
app.command()(up.up)
app.command()(doctor)
app.command()(demo)
app.command()(segment.segment)
app.command()(reward.reward)
app.add_typer(act.app, name="act")
app.add_typer(sim.app, name="sim")
app.add_typer(fit.app, name="fit")
app.add_typer(runs.app, name="runs")
app.add_typer(dataset.app, name="dataset")
app.add_typer(models.app, name="models")


def main() -> None:
    """Runs the command line."""
    app(prog_name="freerein")


if __name__ == "__main__":
    main()
