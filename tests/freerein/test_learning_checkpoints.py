import json
from pathlib import Path

import pytest
import torch

from freerein.learning import checkpoints
from freerein.learning.checkpoints import Checkpoint


def make(step: int) -> Checkpoint:
    tensors = {"weights": torch.full((3, 2), float(step)), "order": torch.arange(step)}
    return Checkpoint(step, tensors, {"rng": {"state": 2**127 + step}, "loss": 0.1})


def newest(folder: Path) -> tuple[int | None, list[int]]:
    """Returns the step of the checkpoint found, and those of the damaged ones."""
    damaged: list[int] = []
    found = checkpoints.newest(folder, on_corrupt=lambda step, _: damaged.append(step))
    return found and found.step, damaged


def steps(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_checkpoint_comes_back_bit_by_bit(tmp_path: Path) -> None:
    checkpoints.save(tmp_path, make(7))
    found = checkpoints.newest(tmp_path, on_corrupt=lambda *_: pytest.fail("damaged"))
    assert found is not None
    assert found.step == 7
    assert found.document == make(7).document
    assert torch.equal(found.tensors["weights"], make(7).tensors["weights"])
    assert found.tensors["order"].dtype == torch.int64


def test_an_empty_or_missing_folder_has_no_checkpoint(tmp_path: Path) -> None:
    assert newest(tmp_path) == (None, [])
    assert newest(tmp_path / "missing") == (None, [])


def test_the_last_three_are_kept(tmp_path: Path) -> None:
    for step in range(1, 6):
        checkpoints.save(tmp_path, make(step))
    assert steps(tmp_path) == ["step-000000003", "step-000000004", "step-000000005"]


@pytest.mark.fault("O3")
@pytest.mark.parametrize("name", ["state.safetensors", "state.json", "manifest.json"])
@pytest.mark.parametrize("damage", ["flip", "truncate", "empty", "delete"])
def test_a_damaged_newest_checkpoint_gives_way_to_the_one_before(tmp_path: Path, name: str, damage: str) -> None:
    checkpoints.save(tmp_path, make(1))
    checkpoints.save(tmp_path, make(2))
    path = tmp_path / "step-000000002" / name
    data = path.read_bytes()
    flipped = data[:-9] + bytes([data[-9] ^ 1]) + data[-8:]
    path.write_bytes({"flip": flipped, "truncate": data[:-1], "empty": b"", "delete": b""}[damage])
    if damage == "delete":
        path.unlink()
    assert newest(tmp_path) == (1, [2])


def test_a_damaged_checkpoint_is_replaced_when_its_step_is_reached_again(tmp_path: Path) -> None:
    checkpoints.save(tmp_path, make(2))
    (tmp_path / "step-000000002" / "state.json").write_bytes(b"{")
    checkpoints.save(tmp_path, make(2))
    assert newest(tmp_path) == (2, [])


@pytest.mark.fault("O3")
def test_damaged_checkpoints_of_later_steps_are_not_kept_in_place_of_new_ones(tmp_path: Path) -> None:
    for step in (7, 8, 9):
        checkpoints.save(tmp_path, make(step))
        (tmp_path / f"step-{step:09d}" / "state.json").write_bytes(b"{")
    checkpoints.save(tmp_path, make(1))
    assert (newest(tmp_path), steps(tmp_path)) == ((1, []), ["step-000000001"])


def test_what_a_crash_left_unfinished_is_neither_read_nor_in_the_way(tmp_path: Path) -> None:
    checkpoints.save(tmp_path, make(1))
    unfinished = tmp_path / "step-000000002.tmp"
    unfinished.mkdir()
    (unfinished / "state.json").write_bytes(b"{}")
    assert newest(tmp_path) == (1, [])
    checkpoints.save(tmp_path, make(2))
    assert steps(tmp_path) == ["step-000000001", "step-000000002"]


def test_a_save_that_fails_leaves_the_checkpoints_before_it_alone(tmp_path: Path) -> None:
    checkpoints.save(tmp_path, make(1))
    with pytest.raises(ValueError, match="not JSON compliant"):
        checkpoints.save(tmp_path, Checkpoint(2, {}, {"loss": float("nan")}))
    assert steps(tmp_path) == ["step-000000001"]


def test_a_manifest_that_vouches_for_hostile_json_is_refused(tmp_path: Path) -> None:
    checkpoints.save(tmp_path, make(1))
    (tmp_path / "step-000000001" / "manifest.json").write_text(json.dumps({"files": "[" * 100_000}))
    (tmp_path / "step-000000001" / "state.json").write_bytes(b"[" * 100_000)
    assert newest(tmp_path) == (None, [1])
