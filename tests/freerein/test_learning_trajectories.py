import json
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from freerein.data import DatasetSpec, check, create
from freerein.data.layout import SPEC_FILE
from freerein.errors import InvalidInput
from freerein.learning.fit_dataset import FitDataset
from freerein.learning.trajectories import Trajectories
from freerein.types.common import ActionSpec, Trajectory

LENGTHS = (3, 5, 4, 6)


def frames(side: int) -> list[npt.NDArray[np.uint8]]:
    return [np.full((length, side, side, 3), length, np.uint8) for length in LENGTHS]


def actions() -> list[npt.NDArray[np.float32]]:
    return [np.zeros((length, 2), np.float32) for length in LENGTHS]


def make() -> Trajectories:
    tags = [("pick",), ("push",), ("pick", "push"), ("pick",)]
    ends = [np.arange(length) == length - 1 for length in LENGTHS]
    cameras = {"front": frames(4), "wrist": frames(6)}
    return Trajectories(cameras, actions(), tags, ["a", "b", "a", "b"], terminated=ends)


def test_the_split_is_of_whole_trajectories_without_copying_frames() -> None:
    whole = make()
    training, validation = whole.split(fraction=0.25, seed=0)
    assert (len(training), len(validation)) == (3, 1)
    assert sorted([*training.lengths(), *validation.lengths()]) == sorted(LENGTHS)
    parts = [*training.frames["wrist"], *validation.frames["wrist"]]  # type: ignore[misc]  # lists here
    assert {id(each) for each in parts} == {id(each) for each in whole.frames["wrist"]}  # type: ignore[attr-defined]


def test_a_subset_keeps_everything_of_its_trajectories() -> None:
    part = make().subset([2, 0])
    assert part.lengths().tolist() == [4, 3]
    assert (list(part.skills), list(part.goal_texts)) == ([("pick", "push"), ("pick",)], ["a", "a"])
    assert [each.tolist() for each in part.terminated] == [[False] * 3 + [True], [False] * 2 + [True]]


def test_trajectories_that_are_too_short_are_left_out_of_the_split() -> None:
    training, validation = make().split(fraction=0.5, seed=0, min_length=5)
    assert sorted([*training.lengths(), *validation.lengths()]) == [5, 6]
    with pytest.raises(InvalidInput, match="2 trajectories of 6 or more timesteps"):
        make().split(fraction=0.5, seed=0, min_length=6)


def test_frames_are_sampled_from_every_trajectory_and_camera() -> None:
    sampled = make().sample_frames(6)
    assert {camera: each.shape[1:] for camera, each in sampled.items()} == {"front": (4, 4, 3), "wrist": (6, 6, 3)}
    assert set(sampled["front"][:, 0, 0, 0].tolist()) == set(LENGTHS)


def test_fewer_frames_are_sampled_where_they_are_large() -> None:
    large = [np.broadcast_to(np.uint8(0), (100, 1024, 1024, 3))] * 2
    sampled = Trajectories({"front": large}, [np.zeros((100, 2), np.float32)] * 2).sample_frames(2000)
    assert 2**26 < sampled["front"].numel() <= 2**27


def test_arrays_that_do_not_fit_together_are_refused() -> None:
    with pytest.raises(InvalidInput, match="same trajectories"):
        Trajectories({"front": frames(4)[:2]}, actions())
    with pytest.raises(InvalidInput, match="same trajectories"):
        Trajectories({"front": frames(4)}, actions(), [("pick",)])
    with pytest.raises(InvalidInput, match="Trajectory 3 must have as many frames as actions"):
        Trajectories({"front": [*frames(4)[:3], frames(4)[0]]}, actions())
    with pytest.raises(InvalidInput, match="Trajectory 0 must have as many frames as actions"):
        Trajectories({"front": frames(4)}, actions(), terminated=[np.zeros(1, bool)] * 4)
    with pytest.raises(InvalidInput, match="1 or more"):
        Trajectories({"front": []}, [])


@pytest.mark.parametrize(
    ("value", "any_unit", "is_refused"), [(0.5, False, False), (300, True, False), (300, False, True)]
)
def test_a_fit_that_does_not_scale_actions_refuses_a_unit_of_their_own(
    tmp_path: Path, value: float, any_unit: bool, is_refused: bool
) -> None:
    spec = DatasetSpec(10, {"front": (4, 4, 3)}, ActionSpec(2, 0, ("x", "y")), "arm", has_scaled_actions=False)
    with create(tmp_path / "datasets" / "own", spec) as writer:
        writer.append(Trajectory({"front": frames(4)[0]}, np.full((3, 2), value, np.float32)))
    with pytest.raises(InvalidInput, match="unit of their own") if is_refused else nullcontext():
        FitDataset.open(tmp_path, "own").trajectories(["front"], any_unit=any_unit)


def test_a_fit_refuses_actions_that_check_calls_an_error(tmp_path: Path) -> None:
    """Even where the dataset says that they are scaled: it was edited since."""
    root = tmp_path / "datasets" / "own"
    spec = DatasetSpec(10, {"front": (4, 4, 3)}, ActionSpec(2, 0, ("x", "y")), "arm", has_scaled_actions=False)
    with create(root, spec) as writer:
        writer.append(Trajectory({"front": frames(4)[0]}, np.full((3, 2), 300, np.float32)))
    path = root / SPEC_FILE
    path.write_text(json.dumps({**json.loads(path.read_text()), "has_scaled_actions": True}))
    (problem,) = (each for each in check(root) if each.where == "trajectory 0")
    with pytest.raises(InvalidInput) as refused:
        FitDataset.open(tmp_path, "own").trajectories(["front"], any_unit=True)
    assert problem.severity == "error"
    assert "in [-1, 1]" in problem.sentence
    assert "in [-1, 1]" in refused.value.detail
