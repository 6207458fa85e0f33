"""Tags and true labels as people write them: several skills in a cell, spellings, times in seconds, exports of ELAN."""

import json
import re
import shutil
import unicodedata
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from freerein.cli.__main__ import app
from freerein.data import Dataset, DatasetSpec, LabelOptions, create, label, tag, truth, verify
from freerein.data.annotations import read_tags
from freerein.errors import InvalidInput
from freerein.types.common import ActionSpec, Trajectory

FPS, LENGTH = 10, 12
HEADER = b"trajectory,skills\n"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two trajectories of 1.2 seconds, tagged with reach and pour."""
    root = tmp_path_factory.mktemp("made") / "own"
    spec = DatasetSpec(FPS, {"top": (2, 2, 3)}, ActionSpec(1, 0, ("x",)), "arm", skills=("pour", "reach"))
    with create(root, spec) as writer:
        for _ in range(2):
            frames = {"top": np.zeros((LENGTH, 2, 2, 3), np.uint8)}
            writer.append(Trajectory(frames, np.zeros((LENGTH, 1), np.float32), ("pour", "reach")))
    return root


@pytest.fixture
def root(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of them, as a dataset of the data directory."""
    monkeypatch.setenv("FREEREIN_DATA_DIR", str(tmp_path))
    return Path(shutil.copytree(made, tmp_path / "datasets" / "own"))


def test_another_separator_of_skills_is_refused_and_the_right_one_is_named(root: Path) -> None:
    for separator in (",", "|", "/", "\\", "&", "+", ", ", "\n", "\t", "\uff1b", "\uff0c", "\u3001"):
        table = HEADER + f'0,"reach{separator}pour"\n'.encode()
        for read in (partial(tag, root), partial(read_tags, names=["0"])):
            with pytest.raises(InvalidInput, match="column `skills`, must separate skills by `;`, such as reach;pour"):
                read(table)


def test_skills_without_quotes_are_hinted_to_the_separator(root: Path) -> None:
    with pytest.raises(InvalidInput) as caught:
        tag(root, HEADER + b"0,reach,pour\n")
    assert "Line 2 must have 2 columns; it has 3" in caught.value.detail
    assert "`;`" in caught.value.hint


def test_a_skill_that_the_dataset_has_may_hold_a_separator(tmp_path: Path) -> None:
    spec = DatasetSpec(FPS, {"top": (2, 2, 3)}, ActionSpec(1, 0, ("x",)), "arm", skills=("grasp, then lift",))
    with create(tmp_path / "own", spec) as writer:
        writer.append(Trajectory({"top": np.zeros((1, 2, 2, 3), np.uint8)}, np.zeros((1, 1), np.float32)))
    tag(tmp_path / "own", HEADER + b'0,"grasp, then lift"\n')
    assert Dataset(tmp_path / "own").skills == (("grasp, then lift",),)


@pytest.mark.parametrize("written", ["Reach", "REACH ", " reach", "rea\u0301ch"])
def test_spellings_of_a_skill_are_one_and_it_is_said(root: Path, written: str) -> None:
    tag(root, HEADER + "0,re\u00e1ch\n".encode())
    notes = list[str]()
    tag(root, HEADER + f"1,{written}\n".encode(), on_note=notes.append)
    if written == "rea\u0301ch":  # looks the same
        assert (Dataset(root).skills[1], notes) == (("re\u00e1ch",), [])
    else:
        assert Dataset(root).skills[1] == ("reach",)


def test_spellings_within_a_table_are_one_too(root: Path) -> None:
    notes = list[str]()
    tag(root, HEADER + b"0,Open  Drawer;Pour\n1,open drawer;POUR;pour\n", on_note=notes.append)
    assert Dataset(root).skills == (("Open Drawer", "pour"), ("Open Drawer", "pour"))
    assert [each.split("`")[1:4:2] for each in notes] == [
        ["Pour", "pour"],
        ["open drawer", "Open Drawer"],
        ["POUR", "pour"],
    ]


def test_names_of_trajectories_are_compared_in_normal_form() -> None:
    decomposed = unicodedata.normalize("NFD", "Gef\u00e4\u00df 1")
    assert read_tags(HEADER + "Gef\u00e4\u00df 1,reach\n".encode(), [decomposed]) == {decomposed: ("reach",)}
    assert read_tags(HEADER + f"{decomposed},reach\n".encode(), ["Gef\u00e4\u00df 1"]) == {
        "Gef\u00e4\u00df 1": ("reach",)
    }


def labels(root: Path, index: int = 0) -> str:
    """Returns the labels of a trajectory by their first letters; a dot where there is none."""
    skills = Dataset(root).spec.skills
    return "".join("." if each < 0 else skills[each][0] for each in truth.labels(root, index))


FIRST = LabelOptions(trajectory=0)
ELAN = "default\t\t00:00:00.000\t0.0\t0\t00:00:00.500\t0.5\t500\t00:00:00.500\t0.5\t500\treach\n"
ELAN += "default\t\t00:00:00.700\t0.7\t700\t00:00:01.200\t1.2\t1200\t00:00:00.500\t0.5\t500\tpour\n"
NAMED = "Tier\tBegin Time - hh:mm:ss.ms\tEnd Time - hh:mm:ss.ms\tDuration - hh:mm:ss.ms\tAnnotation\n"
NAMED += "main\t00:00:00.000\t00:00:00.500\t00:00:00.500\treach\nmain\t00:00:00.700\t00:00:01.200\t00:00:00.500\tpour\n"
OWN_COLUMN = '"#file:///video.mp4 -- offset: 0"\n\nBegin Time - ss.msec\tEnd Time - ss.msec\tDuration - ss.msec\tmain\n'
OWN_COLUMN += "0.0\t0.5\t0.5\treach\n0.7\t1.2\t0.5\tpour\n0.5\t0.6\t0.1\t\n"


EACH = ["reach"] * 5 + [""] * 2 + ["pour"] * 5
BY_TIMESTEP = "trajectory,timestep,skill\n" + "".join(f"0,{t},{skill}\n" for t, skill in enumerate(EACH) if skill)


def test_labels_are_read_as_people_have_them(root: Path) -> None:
    for table, options in (
        ("trajectory,start,end,skill\n0,0,5,reach\n0,7,12,pour\n", LabelOptions()),
        ("skill,end,start,episode\nreach,5,0,0\npour,12,7,0\n", LabelOptions()),
        ("trajectory,start,end,skill\n0,0.0,0.5,reach\n0,0.7,1.2,pour\n", LabelOptions()),
        ("trajectory,start_s,end_s,skill\n0,0,0.5,reach\n0,0.7,1.2,pour\n", LabelOptions()),
        ("trajectory,start_time_ms,end_time_ms,label\n0,0,500,reach\n0,700,1200,pour\n", LabelOptions()),
        ("start_frame,end_frame,label\n0,5,reach\n7,12,pour\n", FIRST),
        ("start (s);end (s);label\n0;0.5;reach\n0.7;1.2;pour\n", FIRST),
        ("reach 0.0 0.5\npour 0.7 1.2\n", FIRST),
        ("0 5 reach\n7 12 pour\n", FIRST),
        ("0.000000\t0.500000\treach\n0.700000\t1.200000\tpour\n", FIRST),
        (BY_TIMESTEP, LabelOptions()),
        ("frame,label\n" + "".join(f"{t},{skill}\n" for t, skill in enumerate(EACH)), FIRST),
        ("timestamp,label\n" + "".join(f"{t / 10},{skill}\n" for t, skill in enumerate(EACH)), FIRST),
        ("timestamp,label\n" + "".join(f"{np.float32(t / 10):.20f},{skill}\n" for t, skill in enumerate(EACH)), FIRST),
        ("reach 0.0004 0.5009\npour 7.004e-1 1.2\n", FIRST),
        (ELAN, FIRST),
        ("Ebene\tAnfang\tEnde\tWert\nmain\t0.0\t0.5\treach\nmain\t0.7\t1.2\tpour\n", FIRST),
        ("start,end,skill\n0.0,5.0,reach\n7.0,12.0,pour\n", LabelOptions(trajectory=0, unit="timesteps")),
        (NAMED, FIRST),
        (NAMED.replace("main", "other", 1).replace("other", "main"), LabelOptions(trajectory=0, tier="main")),
        (NAMED + "gaze\t00:00:00.000\t00:00:01.200\t00:00:01.200\tcup\n", LabelOptions(trajectory=0, tier="main")),
        (OWN_COLUMN, FIRST),
        ("trajectory,start,end,skill\n0,0,500,reach\n0,700,1200,pour\n", LabelOptions(unit="milliseconds")),
    ):  # fmt: skip
        truth.discard(root, 0)
        notes = list[str]()
        assert label(root, table.encode(), options=options, on_note=notes.append) == 1
        assert labels(root) == "rrrrr..ppppp", table
        assert "2 of 12 timesteps of trajectory 0 have no label: they are not measured." in notes
    assert (truth.labelled(root), verify(root)) == ([0], [])


def test_a_label_a_line_is_of_the_timesteps_in_order(root: Path) -> None:
    label(root, b"label\n" + b"reach\n" * 5 + b"pour\n" * 7, options=FIRST)
    assert labels(root) == "rrrrrppppppp"


def test_segments_in_seconds_meet_without_a_gap_and_may_end_with_the_last_frame(root: Path) -> None:
    label(root, b"reach 0 0.333\npour 0.333 1.21\n", options=FIRST)
    assert labels(root) == "rrrrpppppppp"


def test_a_table_of_labels_that_cannot_be_read_names_line_and_column(root: Path) -> None:
    for table, options, where in (
        ("reach 0.0 1.2\n", LabelOptions(), "Line 1 must name a column `trajectory`"),
        ("reach 0.0 9.9\n", FIRST, "Line 1, column `3`, must be a time in [0.1, 1.2] seconds"),
        ("reach 0.5 0.5\n", FIRST, "Line 1, column `3`, must be a time"),
        ("reach 0.0 0.5\npour 0.4 1.2\n", FIRST, "Line 2, column `2`, must begin where no other segment is"),
        ("reach 0.0 0.5\npour x 1.2\n", FIRST, "Line 2, column `2`, must be a time"),
        ("reach 0.0 0.5\npour 1.2\n", FIRST, "Line 2 must have 3 columns; it has 2"),
        ("reach 1.2 1.3\n", FIRST, "Line 1, column `2`, must be a time in [0, 1.1] seconds"),
        ("reach;pour\t0.0\t0.5\n", FIRST, "Line 1, column `1`, must separate skills by `;`"),
        ("start,end,skill\n0.5,5.0,reach\n", LabelOptions(trajectory=0, unit="timesteps"), "Line 2, column `start`"),
        ("wave 0.0 0.5\n", FIRST, "Line 1, column `1`, must be among the tags of trajectory 0, pour, reach"),
        ("reach 0.0 0.5\n", LabelOptions(trajectory=2), "The trajectory must be in [0, 1]; got 2"),
        ("0,0,4,reach\n", LabelOptions(), "Line 1 must name the columns"),
        ("a,b\n", LabelOptions(), "Line 1 must name"),
        ("", FIRST, "the table is empty"),
        ("label\n" + "reach\n" * 13, FIRST, "Line 14, column `label`, must be one of 12"),
        ("frame,label\n3,reach\n3,pour\n", FIRST, "Line 3, column `frame`, must begin where no other"),
        ("frame,label\n12,reach\n", FIRST, "Line 2, column `frame`, must be a whole number in [0, 11]"),
        ("trajectory,start,end,skill\n7,0,4,reach\n", LabelOptions(), "Line 2, column `trajectory`"),
        ("trajectory,start,end,skill\n0,0,4,\"reach,pour\"\n", LabelOptions(), "Line 2, column `skill`, must separate"),
        (NAMED + "gaze\t00:00:00.000\t00:00:01.200\t00:00:01.200\tcup\n", FIRST, "there are 2: main, gaze"),
        (NAMED, LabelOptions(trajectory=0, tier="gaze"), "there are 1: main"),
    ):  # fmt: skip
        with pytest.raises(InvalidInput, match=re.escape(where)):
            label(root, table.encode(), options=options)
    assert truth.labelled(root) == []


def test_a_label_that_the_tags_of_its_trajectory_lack_is_refused_or_becomes_one(root: Path) -> None:
    tag(root, HEADER + b"0,pour\n")
    table = b"trajectory,start,end,skill\n0,0,3,reach\n1,0,3,reach\n"
    with pytest.raises(InvalidInput, match="Line 2, column `skill`, must be among the tags of trajectory 0, pour;"):
        label(root, table)
    label(root, table + b"1,3,6,wave\n", with_tags=True)
    assert Dataset(root).skills == (("pour", "reach"), ("pour", "reach", "wave"))
    assert (labels(root, 0), labels(root, 1)) == ("rrr.........", "rrrwww......")


def test_trajectories_without_tags_are_tagged_from_their_labels(root: Path) -> None:
    tag(root, HEADER + b"0,\n1,\n")
    label(root, b"Reach 0.0 0.6\nreach 0.6 0.9\n", options=FIRST, with_tags=True)
    assert Dataset(root).skills == (("Reach",), ())


def run(*words: str) -> dict[str, Any]:
    result = CliRunner().invoke(app, ["dataset", *words, "--json"])
    assert result.exit_code == 0, result.output
    return dict(json.loads(result.stdout))


def test_the_commands_say_what_was_taken_for_what(root: Path, tmp_path: Path) -> None:
    (tmp_path / "tags.csv").write_text("trajectory,skills\n0,Reach;pour\n")
    assert [each[:30] for each in run("tag", "own", str(tmp_path / "tags.csv"))["notes"]] == [
        "`Reach` was taken for `reach`:"
    ]
    (tmp_path / "labels.txt").write_text(ELAN + ELAN.replace("default", "gaze"))
    words = ("--trajectory", "1", "--tier", "default", "--unit", "seconds", "--tags")
    document = run("label", "own", str(tmp_path / "labels.txt"), *words)
    assert (document["labelled"], labels(root, 1)) == (1, "rrrrr..ppppp")
    refused = CliRunner().invoke(app, ["dataset", "tag", "own", str(tmp_path / "labels.txt"), "--json"])
    assert (refused.exit_code, json.loads(refused.stderr)["error"]["field"]) == (1, "header")
    assert document["notes"] == ["2 of 12 timesteps of trajectory 1 have no label: they are not measured."]
