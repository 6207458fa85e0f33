"""The table of a session, from what its result holds."""

from collections.abc import Mapping
from functools import partial
from typing import Any

from experiments.first_session.figures import Figure, Session, figures, returns_by_panel
from experiments.first_session.pipeline import FULL, TASKS, TEXTS
from experiments.workbench.claims import Claim
from experiments.workbench.plots import png
from experiments.workbench.results import ArmResult
from experiments.workbench.table import Picture, Section, Table, words
from freerein.cli.demo.curves import returns_figure
from freerein.cli.demo.evaluations import Measured

_MOST_IN_DIGITS = 1000
"""From here on numbers are shown without exponent."""

_HEADER = ("figure", "value", "95 % interval", "baseline", "bar", "")


def shown(evaluations: Mapping[str, Mapping[str, Any]], seconds: Mapping[str, float], curve: Any) -> dict[str, Any]:
    """Returns what a result keeps: the results of evaluations by step, the seconds of steps, and the curve of PPO."""
    kept = {
        step: {name: result[name] for name in ("figures", "episodes", "told") if name in result}
        for step, result in evaluations.items()
    }
    return {"evaluations": kept, "seconds": dict(seconds), "ppo_returns": [list(point) for point in curve]}


def session_of(kept: Mapping[str, Any]) -> Session:
    """Returns the session that a result keeps."""
    evaluations = {
        step: {name: Measured(**figure) for name, figure in result["figures"].items()}
        for step, result in kept["evaluations"].items()
    }
    tasks, texts = ({each: side for side, each in names.items()} for names in (TASKS, TEXTS))
    told = {
        (tasks[row["task"]], texts[row["goal_text"]]): Measured(**row["return_mean"])
        for row in kept["evaluations"]["sentences"]["told"]
    }
    trials = {step: result["episodes"] for step, result in kept["evaluations"].items()}
    return Session(evaluations, trials, told, kept["seconds"])


def table(result: ArmResult) -> Table:
    """Returns the table of a result."""
    session = session_of(result.shown)
    total = Figure("total_s", 1, Measured(60 * result.minutes, None, None, None))
    found = [*figures(session), total]
    has_bars = result.options["size"] == FULL
    return Table(
        title="A first session, measured",
        text=words("first_session").replace("{name}", result.name),
        sections=(Section(_HEADER, tuple(_cells(each, has_bar=has_bars) for each in found)),),
        claims=tuple(_claim(each, result) for each in found) if has_bars else (),
        picture=Picture("PPO from random weights, then distillation", partial(_draw, session, result.shown)),
    )


def _cells(figure: Figure, *, has_bar: bool) -> tuple[str, ...]:
    measured = figure.measured
    interval = f"{measured.interval[0]:.3g} to {measured.interval[1]:.3g}" if measured.interval else ""
    baseline = f"{measured.baseline:.3g} ({figure.baseline_text})" if measured.baseline is not None else ""
    bar = (figure.bar, {None: "", True: "met", False: "not met"}[figure.met]) if has_bar else ("", "")
    return figure.name, _number(measured.value), interval, baseline, *bar


def _number(value: float) -> str:
    return f"{value:.3g}" if abs(value) < _MOST_IN_DIGITS else f"{value:.0f}"


def _claim(figure: Figure, result: ArmResult) -> Claim:
    measured = figure.measured
    return Claim(
        claim=figure.name,
        value=measured.value,
        low=measured.low,
        high=measured.high,
        seeds=1,
        trials=figure.trials,
        baseline=measured.baseline,
        target=figure.target,
        met=figure.met,
        world_version=result.world_version,
        command=result.command,
        minutes=result.minutes,
    )


def _draw(session: Session, kept: Mapping[str, Any]) -> bytes:
    figure = returns_figure(
        [(iteration, value) for iteration, value in kept["ppo_returns"]],
        returns_by_panel(session),
        title="PPO from random weights, then distillation into a language policy",
        subtitle="control steps of 100 at the goal by true states, in the same 50 episodes each; lines are 95 % "
        "intervals",
    )
    return png(figure)
