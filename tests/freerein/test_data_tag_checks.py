"""Which tags and first frames `freerein dataset check` complains of, and how much."""

import re
from pathlib import Path

import numpy as np
import pytest

from freerein.data import DatasetSpec, check, create
from freerein.data.first_frames import first_frame_tests, low_resolution
from freerein.data.tag_checks import FEWEST, tag_problems
from freerein.types.common import ActionSpec, Trajectory

APART = [("a",)] * FEWEST + [("b",)] * FEWEST


def found(skills: tuple[str, ...], tags: list[tuple[str, ...]]) -> list[tuple[str, str]]:
    return [(each.severity, each.sentence) for each in tag_problems(skills, tags)]


def test_skills_that_occur_apart_and_often_are_no_problem() -> None:
    assert found(("a", "b"), APART) == []


@pytest.mark.parametrize(
    ("skills", "tags", "word"),
    [
        ((), [(), ()], "names no skills"),
        (("a", "b"), [*APART, (), ()], "2 are not"),
        (("a", "b"), [*APART, ("a", "x"), ("b", "y")], "2 tags are not"),
    ],
)
def test_what_a_fit_refuses_is_an_error(skills: tuple[str, ...], tags: list[tuple[str, ...]], word: str) -> None:
    ((severity, sentence),) = found(skills, tags)
    assert (severity, word in sentence) == ("error", True)


@pytest.mark.parametrize(
    ("skills", "tags", "word"),
    [
        (("a", "b", "c"), [(*each, "c") for each in APART], "'c' must occur in some .* it occurs in all"),
        (("a", "b", "c"), APART, "'c' must occur in some .* it occurs in none"),
        (("a", "b", "c"), [("a", "c")] * FEWEST + [("b",)] * FEWEST, "'a', 'c' always occur together"),
        (("a", "b"), APART[1:], f"{FEWEST} or more trajectories with it; 'a' has {FEWEST - 1}"),
        (("a", "b"), [*APART[:-1], ("a", "b")], "without it; 'a' has 9"),
    ],
)
def test_what_tags_cannot_teach_is_a_warning(skills: tuple[str, ...], tags: list[tuple[str, ...]], word: str) -> None:
    problems = tag_problems(skills, tags)
    assert {each.severity for each in problems} == {"warning"}
    assert any(re.search(word, each.sentence) for each in problems)


def scenes(count: int, *, telling: bool) -> tuple[np.ndarray, list[tuple[str, ...]]]:
    """Returns first frames of a bright block on either side, and tags that name its side, or nothing of it."""
    rng = np.random.default_rng(0)
    frames, tags = rng.integers(0, 40, (count, 24, 32, 3), np.uint8), []
    for frame in frames:
        side = int(rng.integers(2))
        x = 16 * side + int(rng.integers(10))
        frame[8:14, x : x + 6] = 250
        tags.append(("a", "b")[side if telling else int(rng.integers(2))])
    return frames, [(tag,) for tag in tags]


@pytest.mark.parametrize("telling", [True, False])
def test_first_frames_are_tested_for_what_they_tell_of_the_tags(telling: bool) -> None:
    frames, tags = scenes(60, telling=telling)
    tests = first_frame_tests(np.array([low_resolution(each) for each in frames]), tags, rng=np.random.default_rng(1))
    assert [each.skill for each in tests] == ["a", "b"]
    assert all((each.auroc > 0.9 and each.p_value <= 0.01) == telling for each in tests)


def test_under_chance_small_p_values_are_as_rare_as_they_say() -> None:
    rng, least = np.random.default_rng(2), []
    for _ in range(20):
        tags = [("a",) if occurs else ("b",) for occurs in rng.random(40) < 0.5]
        least += [min(each.p_value for each in first_frame_tests(rng.random((40, 8), np.float32), tags, rng=rng))]
    assert np.mean(np.array(least) <= 0.1) <= 0.25


def test_equal_first_frames_tell_nothing() -> None:
    _, tags = scenes(60, telling=True)
    tests = first_frame_tests(np.ones((60, 4), np.float32), tags, rng=np.random.default_rng(1))
    assert all(each.p_value > 0.01 or each.auroc < 0.6 for each in tests)


def test_a_dataset_whose_first_frames_give_the_tags_away_is_fit_with_a_warning(tmp_path: Path) -> None:
    frames, tags = scenes(40, telling=True)
    spec = DatasetSpec(10, {"top": (24, 32, 3)}, ActionSpec(1, 0, ("x",)), "arm", ("a", "b"))
    with create(tmp_path / "demos", spec) as writer:
        for frame, skills in zip(frames, tags, strict=True):
            writer.append(Trajectory({"top": frame[None]}, np.zeros((1, 1), np.float32), skills))
    problems = check(tmp_path / "demos")
    assert {each.severity for each in problems} == {"warning"}
    assert ["camera top tell 'a' with an AUROC of" in each.sentence for each in problems] == [True, False]
