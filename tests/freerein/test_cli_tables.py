"""Tables have a line for each thing: names are whole, and what is too wide is cut or wrapped between words."""

import pytest

from freerein.cli.tables import show_table, table_lines

RUNS = [
    ("run", "name", "state", "metrics"),
    ("8bc1f7a2", "ppo-yellow-left-of-green", "succeeded", "episode_return=0.91 entropy=0.2 value_loss=0.01"),
    ("04be2150", "collect-mine", "failed", ""),
]


def test_a_line_on_a_terminal_is_as_wide_as_the_terminal_and_cuts_no_word() -> None:
    lines = table_lines(RUNS, width=80, last="cut")
    assert max(map(len, lines)) == 80
    assert lines[1] == "8bc1f7a2  ppo-yellow-left-of-green  succeeded  episode_return=0.91 entropy=0.2 …"
    assert lines[2] == "04be2150  collect-mine              failed"


@pytest.mark.parametrize("width", [10, 40, 48, 60])
def test_names_are_whole_however_narrow_the_terminal_is(width: int) -> None:
    lines = table_lines(RUNS, width=width, last="cut")
    assert len(lines) == 3
    assert "ppo-yellow-left-of-green  succeeded" in lines[1]
    assert {*" ".join(lines).split()} <= {"…", *" ".join(map(" ".join, RUNS)).split()}


def test_elsewhere_than_on_a_terminal_everything_is_on_the_line() -> None:
    assert table_lines(RUNS, width=None, last="cut")[1].endswith("value_loss=0.01")


def test_a_sentence_is_wrapped_below_itself_between_words() -> None:
    row = ("error", "take-1", "Run `freerein dataset check NAME --camera=a-name-that-is-rather-long` to see which.")
    lines = table_lines([("", "where", "problem"), row], width=40, last="wrapped")
    assert [line[:15].strip() for line in lines] == ["where", "error  take-1", *[""] * (len(lines) - 2)]
    assert " ".join(line[15:] for line in lines[1:]) == row[2]


def test_letters_of_double_width_are_aligned() -> None:
    lines = table_lines([("dataset", "changed"), ("積み木", "3 min ago")], width=80, last="whole")
    assert lines == ["dataset  changed", "積み木   3 min ago"]


def test_a_column_without_anything_in_it_is_left_out(capsys: pytest.CaptureFixture[str]) -> None:
    show_table(("run", "model", "error"), [("8bc1f7a2", "", "")], last="cut")
    assert capsys.readouterr().out.split() == ["run", "8bc1f7a2"]


def test_numbers_that_do_not_fit_are_left_out_whole_and_named(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    for name, value in {"TERM": "dumb", "COLUMNS": "30", "LINES": "9"}.items():
        monkeypatch.setenv(name, value)
    show_table(("step", "episode_return", "entropy", "lr"), [("1", "0.5", "1.25", "0.001")], last="left out")
    printed = capsys.readouterr()
    assert printed.out.split() == ["step", "episode_return", "entropy", "1", "0.5", "1.25"]
    assert "terminal: lr." in printed.err
