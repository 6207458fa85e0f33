"""The help of what takes `--set` has its keys, with their defaults, meanings and bounds."""

import re

import pytest
from typer.testing import CliRunner

from freerein import __version__
from freerein.cli.__main__ import app, present_words


def _help(*words: str) -> str:
    result = CliRunner().invoke(app, [*words, "--help"])
    assert result.exit_code == 0, result.output
    return result.stdout


@pytest.mark.parametrize(
    ("words", "key", "default", "meaning"),
    [
        (("fit", "segmentation"), "steps", r"\d+", "Optimiser steps. 1 to 10000000."),
        (("fit", "imitation"), "use_robot_state", "false", "Whether an action also depends"),
        (("fit", "reward"), "seed", "0", "Seed of every random draw."),
        (("run", "ppo"), "clip_range", "0.2", "PPO's clipping range"),
        (("run", "evaluate"), "baseline", '"none"', "A policy that runs"),
        (("run",), "behaviour", '"expert"', "`expert` and `random` are scripted"),
    ],
)
def test_help_has_the_keys_with_default_and_meaning(
    words: tuple[str, ...], key: str, default: str, meaning: str
) -> None:
    assert re.search(f" {key} {default} {re.escape(meaning)}", " ".join(_help(*words).split()))


def test_help_of_one_kind_has_the_keys_of_no_other() -> None:
    text = _help("run", "--set", "count=1", "collect")
    assert "behaviour" in text
    assert "clip_range" not in text


@pytest.mark.parametrize(
    ("earlier", "present"),
    [
        ("runs start ppo --watch", "run ppo --watch"),
        ("runs list --json", "jobs list --service orchestrator --json"),
        ("runs artifacts 8b", "jobs artifacts 8b"),
        ("fit rm 8b 9c", "jobs rm --service fits 8b 9c"),
        ("fit report 8b", "jobs report 8b"),
        ("fit reward list", "fit reward list"),
    ],
)
def test_earlier_names_of_commands_are_still_understood(earlier: str, present: str) -> None:
    assert present_words(earlier.split()) == present.split()


def test_no_line_of_help_is_wider_than_the_terminal() -> None:
    assert max(map(len, _help("fit", "imitation").splitlines())) <= 80


def test_the_version_is_said() -> None:
    assert CliRunner().invoke(app, ["--version"]).stdout.split() == ["freerein", __version__]
