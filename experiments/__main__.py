"""Runs experiments and makes their tables: `python -m experiments list|show|run|table|pack`; see `README.md`."""

import argparse
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

from experiments import pages, registry
from experiments.workbench import results, table
from experiments.workbench.arms import Arm, choose
from experiments.workbench.progress import ArmProgress, progress
from experiments.workbench.runner import Ending, Places, run_arms
from experiments.workbench.table import Table
from freerein.errors import NotFound, ServiceError

_WEEK_MINUTES = 7 * 24 * 60


def main(words: Sequence[str]) -> int:
    """Returns the exit code: 1 where an arm failed or was stopped, 2 for a refused command."""
    arguments = _parser().parse_args(words)
    try:
        exit_code: int = arguments.command(arguments)
    except ServiceError as error:
        print(error.detail, error.hint, file=sys.stderr)
        return 2
    return exit_code


def _list(arguments: argparse.Namespace) -> int:
    """Prints a line for each experiment, or for each arm of the named ones."""
    if arguments.names:
        for name in arguments.names:
            experiment = registry.load(name)
            _print_arms(progress(experiment, experiment.arms, arguments.results / name).arms)
        return 0
    print(f"{'experiment':15}{'arms':>6}{'results':>9}{'minutes':>9}  status")
    for name in registry.EXPERIMENTS:
        experiment = registry.load(name)
        found = progress(experiment, experiment.arms, arguments.results / name)
        present = len(found.arms) - len(found.unfinished)
        print(f"{name:15}{len(found.arms):6}{present:9}{found.minutes:9.0f}  {found.status}")
    return 0


def _print_arms(arms: Sequence[ArmProgress]) -> None:
    width = max((len(each.arm.name) for each in arms), default=0)
    for each in arms:
        minutes = "unknown" if each.minutes is None else f"{each.minutes:.1f}"
        print(f"{each.arm.name:{width}}  {each.state:8}  {minutes:>7} minutes")


def _show(arguments: argparse.Namespace) -> int:
    """Prints the result of an arm as JSON, without what pictures show and its samples by trial."""
    experiment = registry.load(arguments.name)
    folder = arguments.results / arguments.name
    paths = [folder / f"{arm.name}.json" for arm in choose(experiment, [arguments.arm])]
    if not any(path.exists() for path in paths):
        raise NotFound(
            f"An arm must have a result to be shown; {paths[0].stem} has none.",
            hint=f"Run: python -m experiments run {arguments.name} --only '{arguments.arm}'",
        )
    for path in filter(Path.exists, paths):
        result = results.load(path)
        print(json.dumps(asdict(replace(result, samples={}, shown={})), indent=2))
    return 0


def _dry_run(arguments: argparse.Namespace) -> int:
    """Prints the arms that `run` would train."""
    experiment = registry.load(arguments.name)
    chosen = choose(experiment, arguments.only)
    waiting = progress(experiment, chosen, arguments.results / arguments.name).unfinished
    _print_arms(waiting)
    known = [each.minutes for each in waiting if each.minutes is not None]
    print(
        f"{len(waiting)} of {len(chosen)} arms would run; {len(known)} of them took {sum(known):.0f} minutes before, "
        "or other seeds did."
    )
    return 0


def _run(arguments: argparse.Namespace) -> int:
    if arguments.dry_run:
        return _dry_run(arguments)
    experiment, deadline = registry.load(arguments.name), time.monotonic() + 60 * arguments.minutes
    endings = run_arms(
        arguments.name,
        experiment,
        choose(experiment, arguments.only),
        places=Places(arguments.results, arguments.work),
        jobs=arguments.jobs,
        should_stop=lambda: time.monotonic() >= deadline,
        on_end=_report,
    )
    return int(any(ending in ("stopped", "failed") for ending in endings))


def _table(arguments: argparse.Namespace) -> int:
    """Makes the tables of the named experiments, else of all that have results, and the pages that show them."""
    for name in arguments.names or registry.EXPERIMENTS:
        made = make_table(name, arguments.results)
        if made is not None:
            table.save(made, arguments.results / name)
            print(table.markdown(made))
        elif arguments.names or (arguments.results / name / results.TABLE_FILE).exists():
            raise NotFound(
                f"An experiment must have results of its present configuration and world; {name} has none.",
                hint=f"Run: python -m experiments run {name}.",
            )
    if arguments.results == Places.results:
        pages.save(Path())
    return 0


def _pack(arguments: argparse.Namespace) -> int:
    """Packs the results of the named experiments, else of all."""
    for name in arguments.names or registry.EXPERIMENTS:
        registry.load(name)  # refuses an unknown one
        results.pack(arguments.results / name)
    return 0


def make_table(name: str, folder: Path) -> Table | None:
    """Returns the table of an experiment's current results, which lie in `folder / name`; None without any."""
    experiment = registry.load(name)
    found = [each for source in (name, *experiment.sources) for each in registry.load_current(folder / source)]
    return experiment.table(found) if found else None


def _report(arm: Arm, ending: Ending) -> None:
    print(f"{arm.name}: {ending}", flush=True)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m experiments", description="Run experiments, make their tables.")
    commands = parser.add_subparsers(required=True)
    listed = commands.add_parser("list", help="experiments, their arms and results")
    listed.add_argument("names", nargs="*", metavar="NAME", help="show the arms of these; default: all experiments")
    listed.set_defaults(command=_list)
    show = commands.add_parser("show", help="the results of arms: configuration, figures, machine")
    show.add_argument("name", choices=registry.EXPERIMENTS)
    show.add_argument("arm", metavar="PATTERN", help="names of arms, such as 'grid-lse-*-seed0'")
    show.set_defaults(command=_show)
    run = commands.add_parser("run", help="train and evaluate the arms that have no result yet")
    run.add_argument("name", choices=registry.EXPERIMENTS)
    run.add_argument("--jobs", type=int, default=1, help="arms at a time, one thread each")
    run.add_argument("--only", nargs="+", default=(), metavar="PATTERN", help="names of arms, such as 'grid-lse-*'")
    run.add_argument("--minutes", type=float, default=_WEEK_MINUTES, help="stop then; the next run resumes")
    run.add_argument("--dry-run", action="store_true", help="name the arms that would run, and train nothing")
    run.add_argument("--work", type=Path, default=Places.work, help="folder of datasets and checkpoints")
    run.set_defaults(command=_run)
    make = commands.add_parser("table", help="make tables of the arms that have results")
    make.add_argument("names", nargs="*", metavar="NAME", help="default: all that have results")
    make.set_defaults(command=_table)
    pack = commands.add_parser("pack", help="move what results have in common to one archive")
    pack.add_argument("names", nargs="*", metavar="NAME", help="default: all experiments")
    pack.set_defaults(command=_pack)
    for each in (listed, show, run, make, pack):
        each.add_argument("--results", type=Path, default=Places.results, help="folder of results")
    return parser


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
