"""Mutation testing itself: what is changed, and that a test which looks away is found out."""

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from mutants.__main__ import EQUIVALENT, ROOT, TARGETS, Mutant, all_mutants
from mutants.edits import Edit, find_edits
from mutants.trial import Copy, Outcome

SOURCE = b'''"""Text."""
LIMIT: int = 8  # of "\xc3\xa4"


def clip(value: float, name: str = "x") -> float:
    """Returns a value up to the limit."""
    if value > LIMIT and name:
        raise ValueError(f"at most {LIMIT + 1}, not more")
    return value
'''
IMPORT = "from code_under_test import is_adult\n\n\n"
GOOD = IMPORT + "def test_it():\n    assert [is_adult(age) for age in (17, 18)] == [False, True]\n"
BLIND = IMPORT + "def test_it():\n    assert is_adult(40)\n"


def test_conditions_numbers_names_and_statements_are_changed_and_texts_for_people_are_not() -> None:
    changed = {edit.apply(SOURCE).decode() for edit in find_edits(SOURCE)}
    expected = [
        ("= 8 ", "= 9 "),
        ('"x"', "''"),
        ("value > LIMIT and name", "(value > LIMIT or name)"),
        ("value > LIMIT and name", "(not (value > LIMIT and name))"),
        ("value > LIMIT", "(value >= LIMIT)"),
        ('raise ValueError(f"at most {LIMIT + 1}, not more")', "pass"),
        ("return value", "return None"),
    ]
    text = SOURCE.decode()
    assert changed == {text.replace(before, after, 1) for before, after in expected}


def test_every_mutant_is_a_python_file() -> None:
    for mutant in all_mutants()[::60]:
        compile(mutant.edit.apply((ROOT / mutant.path).read_bytes()), mutant.path, "exec")


def test_every_target_has_tests_and_every_equivalent_mutant_exists() -> None:
    assert [test for tests in TARGETS.values() for test in tests if not (ROOT / test).exists()] == []
    known = {
        (path, edit.where, *Mutant(path, edit).change)
        for path in {one["file"] for one in EQUIVALENT}
        for edit in find_edits((ROOT / path).read_bytes())
    }
    assert [one for one in EQUIVALENT if (one["file"], one["where"], one["before"], one["after"]) not in known] == []
    assert all(one["reason"] for one in EQUIVALENT)


@pytest.fixture
def make_copy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Copy]:
    """A function that copies a repository with one test."""
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")  # loading them takes most of the time

    def make(test: str) -> Copy:
        repository = tmp_path / "repository"
        (repository / "src").mkdir(parents=True)
        (repository / "services").mkdir()
        (repository / "services" / "none.txt").touch()
        (repository / "src" / "code_under_test.py").write_text("def is_adult(age):\n    return age >= 18\n")
        (repository / "test_it.py").write_text(test)
        subprocess.run(["git", "init", "-q", repository], check=True)
        return Copy(repository, tmp_path / "copy")

    return make


@pytest.mark.fault("G12")
@pytest.mark.parametrize(
    ("test", "outcome"), [(GOOD, Outcome.KILLED), (BLIND, Outcome.SURVIVED)], ids=["good", "blind"]
)
def test_a_blind_test_lets_a_mutant_survive(make_copy: Callable[[str], Copy], test: str, outcome: Outcome) -> None:
    copy, path = make_copy(test), "src/code_under_test.py"
    source = (copy.folder / path).read_bytes()
    edit = next(each for each in find_edits(source) if b"> 18" in each.apply(source))
    assert copy.try_edit(path, edit, ["test_it.py"], timeout_s=300) is outcome
    assert (copy.folder / path).read_bytes() == source


def test_a_mutant_that_does_not_end_is_ended(make_copy: Callable[[str], Copy]) -> None:
    copy = make_copy(BLIND)
    source = (copy.folder / "src/code_under_test.py").read_bytes()
    endless = Edit(0, len(source), "", "import signal\n\nsignal.pause()\n")
    assert copy.try_edit("src/code_under_test.py", endless, ["test_it.py"], timeout_s=1) is Outcome.TIMED_OUT
    with pytest.raises(RuntimeError, match="exit code 4"):
        copy.test(["test_that_is_not_there.py"], timeout_s=300)
