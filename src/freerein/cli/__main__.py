"""`freerein`: run services, record demonstrations, train, run, label, look after datasets and models."""

import typer

from freerein.cli import act, dataset, fit, models, reward, runs, segment, sim
from freerein.cli.demo import demo
from freerein.cli.doctor import doctor
from freerein.cli.up import up

app = typer.Typer(
    help="Serves learned robot skills. `freerein demo` shows all of it; `freerein doctor` says what is missing.",
    epilog="Exit codes: 0 done, 1 refused or something is wrong, 2 no such command, 130 Ctrl-C, or 0 of `up`.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
app.command()(up)
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
    """Runs one verb."""
    app(prog_name="freerein")


if __name__ == "__main__":
    main()
