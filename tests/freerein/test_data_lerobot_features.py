"""Which features of LeRobot's datasets are read: shapes, names and kinds as tools write them; and what is left out."""

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from tests.lerobot_dataset import CAMERA, DATA, EPISODES, INFO, STEPS, VECTOR, png, write_dataset, write_info
from typer.testing import CliRunner

from freerein.cli.__main__ import app
from freerein.data import Dataset, LeRobotOptions, LeRobotSource, check, import_trajectories, tag
from freerein.data.frame_axes import frame_size
from freerein.errors import InvalidInput

EIGHT = {"dtype": "float32", "shape": [8], "names": None}


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return write_dataset(tmp_path / "theirs")


def add_column(root: Path, name: str, values: Any, feature: dict[str, Any], *, others: dict[str, Any] = INFO) -> None:
    """Adds a column to the data file, and its feature."""
    pq.write_table(pq.read_table(root / DATA.format(0)).append_column(name, [values]), root / DATA.format(0))
    write_info(root, features=others["features"] | {name: feature})


def size_of(shape: Any, names: Any, **info: Any) -> tuple[int, ...] | None:
    return frame_size({"shape": shape, "names": names, "info": info})


def test_the_axes_of_frames_are_told_by_what_is_known() -> None:
    for shape, names in (
        ([4, 6, 3], ["height", "width", "rgb"]),
        ([4, 6, 3], ["Height", "Width", "Colour"]),
        ([4, 6, 3], ["h", "w", "c"]),
        ([3, 4, 6], ["rgb", "height", "width"]),
        ([6, 4, 3], ["width", "height", "channel"]),
        ([4, 6, 3], None),
        ([4, 6, 3], []),
        ([4, 6, 3], {"axes": ["height", "width", "channels"]}),
        ([3, 4, 6], None),
        ([4, 6, 3], ["channels", "height", "width"]),
        ([4, 6, 3], ["x", "y", "z"]),
    ):
        assert size_of(shape, names) == (4, 6, 3), names
    assert size_of([4, 6], ["height", "width"]) == (4, 6, 1)


def test_the_size_that_a_videos_encoder_noted_comes_first() -> None:
    noted = {"video.height": 4, "video.width": 6, "video.channels": 3}
    assert size_of([6, 4, 3], ["height", "width", "channels"], **noted) == (4, 6, 3)
    assert size_of([8, 9, 3], ["height", "width", "channels"], **noted) == (8, 9, 3)  # scaled since


def test_a_camera_whose_shape_is_no_frames_is_named_in_the_error(root: Path) -> None:
    shape: Any
    for shape in ([4, 6, 4], [0, 6, 3], [4, 6, 3, 1], [4.5, 6, 3], ["4", 6, 3], None, [10**9] * 3):
        write_info(root, features={"observation.images.top": CAMERA | {"shape": shape, "names": None}})
        with pytest.raises(InvalidInput, match=r"`observation\.images\.top` cannot be read: its shape"):
            Dataset(root)


def imported(root: Path, *words: str) -> dict[str, Any]:
    result = CliRunner().invoke(app, ["dataset", "import", str(root), "ours", *words, "--json"])
    assert result.exit_code == 0, result.output
    return dict(json.loads(result.stdout.splitlines()[-1]))


@pytest.fixture
def data_dir(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("FREEREIN_DATA_DIR", str(tmp_path / "var"))
    return tmp_path / "var"


def numbers(size: int) -> pa.Array:
    values = np.random.default_rng(size).normal(size=(3 * STEPS, size)).astype(np.float32)
    return pa.array(values.tolist(), pa.list_(pa.float32()))


def test_an_action_of_another_name_is_left_out_aloud_and_read_when_it_is_named(root: Path, data_dir: Path) -> None:
    name = "robot_action"
    features = {"features": {"observation.images.top": CAMERA}}
    add_column(root, name, numbers(8), EIGHT, others=features)
    (note,) = imported(root)["notes"]
    assert f"`{name}` is left out: take it as the action with --action {name}" in note
    import_trajectories(LeRobotSource(root, options=LeRobotOptions(action=(name,))), data_dir / "named")
    ours = Dataset(data_dir / "named")
    assert ours.spec.action.size == 8
    np.testing.assert_array_equal(np.concatenate([each.actions for each in ours]), np.array(numbers(8).to_pylist()))


def test_several_columns_are_one_action_or_state_in_the_order_named(root: Path, data_dir: Path) -> None:
    add_column(root, "state", numbers(8), EIGHT)
    note = imported(root, "--action", "state", "--action", "action", "--state", "action,state")["notes"]
    ours = Dataset(data_dir / "datasets/ours")
    assert note == []
    assert (ours.spec.action.size, ours.spec.action.names) == (10, ("state",) * 8 + ("action",) * 2)
    np.testing.assert_array_equal(ours[1].actions[:, 8:], [[1, -step] for step in range(STEPS)])
    np.testing.assert_array_equal(ours.robot_state(1)[:, :2], [[1, -step] for step in range(STEPS)])


@pytest.mark.parametrize("dtype", ["int64", "bool"])
def test_a_column_of_one_number_may_be_part_of_an_action(root: Path, data_dir: Path, dtype: str) -> None:
    closed = [step % 2 for step in range(3 * STEPS)]
    values = pa.array(np.array(closed, dtype))
    add_column(root, "action.gripper", values, {"dtype": dtype, "shape": [1], "names": ["closed"]})
    imported(root, "--action", "action,action.gripper")
    ours = Dataset(data_dir / "datasets/ours")
    assert ours.spec.action.names == ("action", "action", "closed")
    assert np.concatenate([each.actions[:, 2] for each in ours]).tolist() == closed


def test_check_says_how_an_action_of_another_name_is_taken(root: Path) -> None:
    add_column(root, "actions", numbers(8), EIGHT, others={"features": {"observation.images.top": CAMERA}})
    hints = [each.hint for each in check(root) if each.where == "actions"]
    assert hints == ["Import it: take it as the action with --action actions."]


def test_features_that_are_named_must_be_there(root: Path) -> None:
    for options, words in (
        (LeRobotOptions(action=("nothing",)), "`nothing` is not"),
        (LeRobotOptions(action=("action", "action")), "one is named twice"),
        (LeRobotOptions(action=("observation.images.top",)), "`observation.images.top` is of another kind"),
        (LeRobotOptions(state=("observation.images.top",)), "`observation.images.top` is of another kind"),
        (LeRobotOptions(cameras=("side",)), "`side` must be among those that can be read, `top`"),
    ):
        with pytest.raises(InvalidInput, match=words):
            LeRobotSource(root, options=options)


def test_cameras_are_chosen_and_the_others_are_said(root: Path, data_dir: Path) -> None:
    add_column(root, "observation.images.side", [png(7)] * 3 * STEPS, CAMERA)
    note = imported(root, "--cameras", "side")["notes"]
    assert list(Dataset(data_dir / "datasets/ours").spec.cameras) == ["side"]
    assert note == ["`observation.images.top` is left out: another was chosen."]


def deep(level: int) -> dict[str, Any]:
    """Returns a PNG of 16 bits."""
    buffer = io.BytesIO()
    PIL.Image.fromarray(np.full((4, 6), 1000 + level, np.uint16)).save(buffer, "PNG")
    return {"bytes": buffer.getvalue(), "path": None}


@pytest.mark.parametrize(
    ("key", "feature", "reason"),
    [
        ("observation.images.depth", CAMERA | {"shape": [4, 6, 1]}, "Trajectory 0"),
        ("observation.images.depth", CAMERA | {"shape": [4, 6, 1], "info": {"is_depth_map": True}}, "a depth map"),
        ("observation.images.wrist cam", CAMERA, "its name"),
        ("observation.images.Top", CAMERA, "another camera has its name"),
        ("observation.images.rgbd", CAMERA | {"shape": [4, 6, 4]}, "its shape"),
        ("observation.images.film", CAMERA | {"dtype": "video"}, "does not say where its video lies"),
    ],
)
def test_a_camera_that_cannot_be_read_is_left_out_aloud(
    root: Path, data_dir: Path, key: str, feature: dict[str, Any], reason: str
) -> None:
    add_column(root, key, [deep(step) for step in range(3 * STEPS)], feature)
    (note,) = imported(root)["notes"]
    assert reason in note
    assert key.rpartition(".")[2].lower() in note.lower()
    assert list(Dataset(data_dir / "datasets/ours").spec.cameras) == ["top"]


def test_check_names_a_camera_that_cannot_be_read_where_the_dataset_lies(root: Path) -> None:
    depth = CAMERA | {"shape": [4, 6, 1]}
    add_column(root, "observation.images.depth", [deep(step) for step in range(3 * STEPS)], depth)
    tag(root, b"trajectory,skills\n0,a\n1,b\n2,a\n")
    assert [(each.where, each.severity) for each in check(root) if each.where.startswith("camera")] == [
        ("camera depth", "warning")
    ]
    assert [each.frames["top"].shape for each in Dataset(root).stream([1], cameras=["top"])] == [(STEPS, 4, 6, 3)]


def test_a_missing_video_is_left_out_where_another_camera_is_whole(root: Path, data_dir: Path) -> None:
    columns = {
        "chunk_index": [0] * 3,
        "file_index": [0] * 3,
        "from_timestamp": [0.0, 0.5, 1.0],
        "to_timestamp": [0.5, 1.0, 1.5],
    }
    table = pq.read_table(root / EPISODES)
    for name, values in columns.items():
        table = table.append_column(f"videos/observation.images.film/{name}", [values])
    pq.write_table(table, root / EPISODES)
    write_info(root, features=INFO["features"] | {"observation.images.film": CAMERA | {"dtype": "video"}})
    (note,) = imported(root)["notes"]
    assert "camera `film`: The video `videos/observation.images.film/chunk-000/file-000.mp4`" in note
    result = CliRunner().invoke(app, ["dataset", "import", str(root), "again", "--cameras", "film"])
    assert (result.exit_code, "camera `film`" in result.stderr) == (1, True)


def test_what_else_is_left_out_is_said_before_anything_is_decoded(root: Path, data_dir: Path) -> None:
    add_column(root, "next.reward", pa.array(np.zeros(3 * STEPS, np.float32)), VECTOR | {"shape": [1]})
    result = CliRunner().invoke(app, ["dataset", "import", str(root), "ours"])
    assert result.stdout.splitlines() == [
        "`next.reward` is left out: not read.",
        "3 trajectories of ours are imported.",
    ]
