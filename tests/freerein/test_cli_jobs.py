"""Jobs in the terminal: from numbers to text, and streams that are opened again, without a service."""

import asyncio
import io
import shlex
from collections.abc import AsyncGenerator
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console
from typer.testing import CliRunner

from freerein.cli.__main__ import app
from freerein.cli.jobs.display import draw
from freerein.cli.jobs.ids import is_whole_id, whole_id
from freerein.cli.jobs.next_steps import next_steps
from freerein.cli.jobs.options import configuration
from freerein.cli.jobs.progress import JobProgress, by_relevance
from freerein.cli.jobs.streams import reconnecting
from freerein.cli.jobs.terminal_plot import plot
from freerein.cli.times import ago, duration
from freerein.errors import InvalidInput, Unavailable
from freerein.types.common import ModelRef
from freerein.types.jobs import MetricRow
from freerein.types.learning import Fit
from freerein.types.orchestrator import Run

TIMEOUT_S = 0.1
_RUN = Run("0" * 32, "running", {}, step=0, steps=10, kind="ppo")


def _progress(*steps: int, every_s: float = 2.0) -> JobProgress:
    """A run that came to a step every two seconds; its return is the step."""
    progress = JobProgress()
    for moment, step in enumerate(steps):
        now = replace(_RUN, step=step, metrics={"episode_return": float(step), "entropy": 1.0})
        progress.add(now, at_s=every_s * moment)
    return progress


def test_a_curve_climbs_from_its_least_value_to_its_greatest() -> None:
    assert plot([0, 1], width=2, height=1) == ["⡠⠊"]
    assert plot([-7.0, 7.0], width=4, height=2) == ["⠀⠀⡠⠊", "⡠⠊⠀⠀"]


def test_values_that_are_all_the_same_lie_in_the_middle() -> None:
    assert plot([5, 5, 5], width=3, height=1) == ["⠤⠤⠤"]
    assert plot([5], width=1, height=1) == ["⠤"]


def test_a_jump_is_drawn_without_a_gap() -> None:
    assert plot([0, 0, 1, 1], width=2, height=1) == ["⣀⠏"]
    assert plot([0, 0, 0, 0, 1, 1, 1, 1], width=4, height=2) == ["⠀⠀⡏⠉", "⣀⣀⠇⠀"]


def test_a_long_curve_is_as_wide_as_was_asked_for() -> None:
    lines = plot([float(value % 7) for value in range(10_000)], width=20, height=3)

    assert [len(line) for line in lines] == [20, 20, 20]


def test_the_most_relevant_metrics_come_first() -> None:
    assert by_relevance(["entropy", "value_loss", "episode_return"]) == ["episode_return", "value_loss", "entropy"]


def test_steps_that_are_known_already_are_ignored() -> None:
    progress = JobProgress()
    progress.add_rows(MetricRow(step, {"episode_return": float(step)}) for step in (1, 2, 3))
    for step in (2, 3, 4, 4):
        progress.add(replace(_RUN, step=step, metrics={"episode_return": float(step)}), at_s=0.0)

    assert progress.curves(["episode_return"], most=1) == {"episode_return": [1, 2, 3, 4]}


def test_the_time_left_follows_from_the_pace_since_it_is_watched() -> None:
    progress = _progress(4, 5, 6)
    history = _progress(1, 2, 3, 4, every_s=0.01)

    assert progress.seconds_left == pytest.approx(8)
    assert history.seconds_left is None


def test_the_picture_shows_how_it_stands_and_a_curve_for_each_metric() -> None:
    console = Console(file=io.StringIO(), width=60, color_system=None)
    console.print(draw("run 1234", _progress(4, 5, 6), width=48))
    lines = [line.split() for line in console.file.getvalue().splitlines()]

    assert [*lines[0][:3], *lines[0][-4:]] == ["run", "1234", "running", "6/10", "8", "s", "left"]
    assert lines[1] == ["episode_return", "⠀⠀⠀⠀⠀⣀⡠⠔⠒⠉", "6"]
    assert lines[2] == ["⣀⠤⠔⠊⠉⠀⠀⠀⠀⠀", "4", "to", "6"]
    assert [line[0] for line in lines[3:] if line] == ["entropy", "⠉⠉⠉⠉⠉⠉⠉⠉⠉⠉"]


def test_the_picture_cuts_no_name_and_fits_a_terminal_of_80_columns() -> None:
    progress, name = JobProgress(), "rollout/a_long_name_of_what_is_measured"
    for moment, step in enumerate((100_000, 100_001, 100_002)):
        run = replace(_RUN, step=step, steps=1_000_000, metrics={name: 1.0})
        progress.add(run, at_s=2.0 * moment)
    console = Console(file=io.StringIO(), width=80, color_system=None)
    console.print(draw("run 12345678", progress, width=80))
    first, *curves = console.file.getvalue().splitlines()
    assert (first.split()[:2], first.split()[-5:]) == (["run", "12345678"], ["20", "days", "19", "h", "left"])
    assert curves[0].startswith(f"{name} ")


class Flaky:
    """A stream that breaks off after each of some silences, in seconds, and says one thing after the last."""

    def __init__(self, *silences_s: float) -> None:
        self._silences_s = list(silences_s)

    async def open(self) -> AsyncGenerator[str, None]:
        if self._silences_s:
            await asyncio.sleep(self._silences_s.pop(0))
            raise Unavailable("The service went away.")
        yield "back"


async def test_a_stream_that_was_quiet_for_longer_than_its_service_may_be_away_is_opened_again() -> None:
    quiet = Flaky(2 * TIMEOUT_S, 2 * TIMEOUT_S)
    assert [item async for item in reconnecting(quiet.open, timeout_s=TIMEOUT_S)] == ["back"]


async def test_a_service_that_stays_away_is_given_up() -> None:
    away = Flaky(*[0.0] * 100)
    with pytest.raises(Unavailable, match="went away"):
        await anext(reconnecting(away.open, timeout_s=TIMEOUT_S))


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0, "0 s ago"),
        (59.9, "59 s ago"),
        (60, "1 min ago"),
        (7200, "2 h ago"),
        (86_400, "1 day ago"),
        (1e6, "11 days ago"),
    ],
)
def test_a_time_is_said_as_how_long_ago_it_was(seconds: float, text: str) -> None:
    assert ago(10**18, now_ns=10**18 + int(seconds * 1e9)) == text


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.9, "0 s"),
        (59, "59 s"),
        (61, "1 min 1 s"),
        (3600, "1 h"),
        (6620, "1 h 50 min"),
        (90_000, "1 day 1 h"),
        (1e6, "11 days 13 h"),
    ],
)
def test_a_duration_is_said_in_its_two_largest_units(seconds: float, text: str) -> None:
    assert duration(seconds) == text


def test_nothing_is_said_of_a_time_that_is_unknown() -> None:
    assert not ago(0, now_ns=10**18)


def test_a_configuration_file_that_is_not_there_is_refused_by_its_path(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match=r"missing\.json is not: No such file") as refused:
        configuration("collect", None, tmp_path / "missing.json")
    assert refused.value.field == "config"
    assert "--set" in refused.value.hint


def test_an_id_may_be_given_by_its_first_digits_or_a_readable_name() -> None:
    ids = ["8bc1f7" + "0" * 26, "a" * 32]
    assert whole_id("8bc", ids) == ids[0]
    assert whole_id("ppo-yellow-left-of-green-8bc1f7", ids) == ids[0]
    with pytest.raises(InvalidInput, match="0 ids begin so"):
        whole_id("segmentation-kitchen-8", ids)  # a name as the list shows it
    assert is_whole_id(ids[0])
    assert not is_whole_id("ppo-yellow-left-of-green2-8bc1f7")  # as long as an id
    for given in ("", "ppo-", "ppo-yellow-left-of-green", "ppo-9bc1f7"):
        with pytest.raises(InvalidInput):
            whole_id(given, ids)


@pytest.mark.parametrize("kind", ["collect", "label", "ppo", "fit", "distill", "zsrm", "another"])
def test_every_kind_of_run_says_what_to_do_next(kind: str) -> None:
    names = {"task": "grid", "dataset": "mine", "model_name": "words", "name": "words", "iterations": 92}
    config = {**names, "service": "reward", "config": {"method": "language"}}
    commands = [
        shlex.split(each, comments=True) for each in next_steps("orchestrator", replace(_RUN, kind=kind, config=config))
    ]
    assert commands
    assert all(_parses(words) for words in commands)


@pytest.mark.parametrize("service", ["segmentation", "imitation", "reward"])
def test_every_fit_says_what_to_do_next(service: str) -> None:
    fit = Fit("0" * 32, "succeeded", {"method": "skills"}, dataset="mine", model_name="own", model=ModelRef("own", "1"))
    assert all(_parses(shlex.split(each, comments=True)) for each in next_steps(service, fit))


def test_a_reward_model_of_several_cameras_is_asked_with_an_image_of_each_and_not_audited() -> None:
    fit = Fit("0" * 32, "succeeded", {"cameras": ["front", "left"]}, dataset="mine", model_name="own")
    steps = next_steps("reward", fit)
    assert steps[0] == "freerein reward front=IMAGE.png left=IMAGE.png --goal 'TEXT' --model own"
    assert not any("--audit" in step for step in steps)


def _parses(words: list[str]) -> bool:
    """Returns whether there is such a command with such options."""
    return words[0] == "freerein" and CliRunner().invoke(app, [*words[1:], "--help"]).exit_code == 0
