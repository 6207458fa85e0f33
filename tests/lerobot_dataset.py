"""A LeRobotDataset v3 of images, written with pyarrow alone: actions and brightness tell its three episodes."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from freerein import images

STEPS = 5
EPISODES = "meta/episodes/chunk-000/file-000.parquet"
DATA = "data/chunk-000/file-{:03d}.parquet"
VECTOR = {"dtype": "float32", "shape": [2], "names": None}
CAMERA = {"dtype": "image", "shape": [4, 6, 3], "names": ["height", "width", "channels"]}
INFO: dict[str, Any] = {
    "codebase_version": "v3.0",
    "fps": 10,
    "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
    "features": {"observation.images.top": CAMERA, "action": VECTOR},
}


def png(level: int, shape: tuple[int, ...] = (4, 6, 3)) -> dict[str, Any]:
    """Returns a frame of one brightness, as LeRobot stores images."""
    return {"bytes": images.encode(np.full(shape, level, np.uint8)).data, "path": None}


def rows_of(episode: int) -> dict[str, Any]:
    """Returns rows whose action and brightness tell the episode and the timestep."""
    steps = np.arange(STEPS)
    return {
        "observation.images.top": [png(10 * episode + step) for step in steps],
        "action": pa.array([[episode, -step] for step in steps], pa.list_(pa.float32())),
        "episode_index": np.full(STEPS, episode),
        "frame_index": steps,
    }


def write_episodes(root: Path, **changes: Any) -> None:
    """Writes `meta/episodes`, with columns beside or in place of the usual ones."""
    columns = {
        "episode_index": [0, 1, 2],
        "length": [STEPS] * 3,
        "data/chunk_index": [0] * 3,
        "data/file_index": [0] * 3,
    }
    (root / EPISODES).parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(pa.table(columns | changes), root / EPISODES)


def write_data(root: Path, *files: list[int]) -> None:
    """Writes a data file for each list of episodes."""
    (root / "data/chunk-000").mkdir(parents=True, exist_ok=True)
    for number, episodes in enumerate(files):
        pq.write_table(pa.concat_tables(pa.table(rows_of(each)) for each in episodes), root / DATA.format(number))


def write_info(root: Path, **changes: Any) -> None:
    """Writes `info.json`, with keys in place of those of `INFO`."""
    (root / "meta/info.json").write_text(json.dumps(INFO | changes))


def write_dataset(root: Path) -> Path:
    """Writes three episodes in one data file; returns the folder."""
    write_episodes(root)
    write_data(root, [0, 1, 2])
    pq.write_table(pa.table({"task_index": [0], "task": ["tidy"]}), root / "meta/tasks.parquet")
    write_info(root)
    return root
