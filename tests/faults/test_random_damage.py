"""Folders of other tools with random damage."""

import random
import shutil
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

import PIL.Image
import pytest
from tests.lerobot_dataset import write_dataset

from freerein.data import FolderSource, LeRobotSource, Source, import_trajectories, verify
from freerein.errors import ServiceError


def damaged(data: bytes, rng: random.Random) -> bytes:
    """Returns bytes of which some are replaced, left out or repeated, or that end too early."""
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 8))):
        place = rng.randrange(len(changed) + 1)
        match rng.choice(("replace", "replace", "remove", "repeat", "cut")):
            case "replace":
                changed[place : place + 1] = rng.randbytes(1)
            case "remove":
                del changed[place : place + rng.choice((1, 4, 100))]
            case "repeat":
                changed[place:place] = changed[place : place + rng.choice((1, 4, 100))]
            case "cut":
                del changed[max(place, 1) :]
    return bytes(changed)


def write_folder(root: Path) -> None:
    """Writes two trajectories as people have them: images, a table of actions and tags."""
    for take in ("one", "two"):
        (root / take).mkdir(parents=True)
        for step in range(3):
            PIL.Image.new("RGB", (6, 4), (step, 0, 9)).save(root / take / f"{step}.png")
        (root / take / "actions.csv").write_text("dx,dy\n0,0.5\n1,0\n0.25,-1\n")
    (root / "tags.csv").write_text("trajectory,skills\none,reach;pour\ntwo,reach\n")


@pytest.mark.parametrize(
    ("write", "source"), [(write_dataset, LeRobotSource), (write_folder, FolderSource)], ids=["lerobot", "folder"]
)
def test_a_damaged_folder_is_imported_whole_or_refused_in_words(
    tmp_path: Path, write: Callable[[Path], object], source: Callable[[Path], Source], fuzz: bool
) -> None:
    rng = random.Random(0)
    write(tmp_path / "theirs")
    for number in range(500 if fuzz else 12):
        theirs, ours = tmp_path / f"theirs-{number}", tmp_path / f"ours-{number}"
        shutil.copytree(tmp_path / "theirs", theirs)
        path = rng.choice(files(theirs))
        path.write_bytes(damaged(path.read_bytes(), rng))
        with suppress(ServiceError):
            import_trajectories(source(theirs), ours)
            assert verify(ours) == []
        shutil.rmtree(theirs)
        shutil.rmtree(ours, ignore_errors=True)


def files(root: Path) -> Sequence[Path]:
    """Returns all files below a folder, in order."""
    return sorted(path for path in root.rglob("*") if path.is_file())
