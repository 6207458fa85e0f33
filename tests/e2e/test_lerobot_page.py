"""The blocks of docs/lerobot.md, as a user runs them; the one that needs LeRobot runs in `make compat`."""

import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import PIL.Image
import PIL.ImageDraw
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from freerein.data import Dataset, labels
from freerein.images import encode

HEIGHT, WIDTH, STEPS, EPISODES = 96, 128, 8, 20
COLOURS, SKILLS = ((215, 30, 30), (30, 70, 220)), ("pour", "reach")
JOINTS = ("shoulder_pan.pos", "shoulder_lift.pos")
LOW, HIGH = np.float32([-110, -90]), np.float32([110, 90])  # degrees, as on the page
PIXELS = 4  # that the disc moves by the greatest action, in a timestep
IMAGE = {"dtype": "image", "shape": [HEIGHT, WIDTH, 3], "names": ["height", "width", "channels"]}
VECTOR = {"dtype": "float32", "shape": [2], "names": list(JOINTS)}

pytestmark = pytest.mark.e2e
Shell = Callable[[str], str]


def drawn(middle: npt.NDArray[np.float64], skill: int) -> npt.NDArray[np.uint8]:
    """Returns a disc on gray, uint8 (H, W, 3)."""
    image = PIL.Image.new("RGB", (WIDTH, HEIGHT), (120, 124, 130))
    x, y = middle
    PIL.ImageDraw.Draw(image).ellipse((x - 9, y - 9, x + 9, y + 9), fill=COLOURS[skill])
    return np.asarray(image)


def moved(middle: npt.NDArray[np.float64], degrees: Sequence[float]) -> npt.NDArray[np.float64]:
    """Returns where the disc is after an action."""
    return middle + PIXELS * (2 * (np.array(degrees) - LOW) / (HIGH - LOW) - 1)


class Arm:
    """A robot with the methods of LeRobot's that a control loop uses; it moves the disc."""

    action_features = dict.fromkeys(JOINTS, float)

    def __init__(self, middle: npt.NDArray[np.float64]) -> None:
        self.middle = middle
        self.sent: list[dict[str, float]] = []

    def get_observation(self) -> dict[str, Any]:
        """Returns the joints' positions and the camera's frame."""
        return {**dict.fromkeys(JOINTS, 0.0), "front": drawn(self.middle, 0)}

    def send_action(self, action: dict[str, float]) -> dict[str, float]:
        """Executes an action, clipped as a robot may; returns what was executed."""
        clipped = {name: float(np.clip(value, -100, 100)) for name, value in action.items()}
        self.middle = moved(self.middle, [clipped[name] for name in JOINTS])
        self.sent.append(clipped)
        return clipped


def record(root: Path) -> list[tuple[int, ...]]:
    """Writes a LeRobotDataset v3 of two cameras, an episode after the other in one file; returns the skills in each."""
    rng, rows, orders = np.random.default_rng(0), list[dict[str, Any]](), list[tuple[int, ...]]()
    for episode in range(EPISODES):
        orders.append(((0,), (1,), (0, 1), (1, 0))[episode % 4])
        for skill in orders[-1]:
            degrees = rng.uniform(LOW, HIGH).astype(np.float32)
            middle = np.array([WIDTH, HEIGHT]) / 2 + rng.uniform(-8, 8, 2)
            middle = middle - STEPS / 2 * (moved(middle, degrees) - middle)
            for _ in range(STEPS):
                image = {"bytes": encode(drawn(middle, skill)).data, "path": None}
                vector = degrees.tolist()
                rows.append({"observation.images.front": image, "observation.images.wrist": image})
                rows[-1] |= {"observation.state": vector, "action": vector, "episode_index": episode}
                middle = moved(middle, degrees)
    lengths = [STEPS * len(order) for order in orders]
    episodes = {"episode_index": range(EPISODES), "length": lengths, "tasks": [["tidy"]] * EPISODES}
    episodes |= {f"data/{name}_index": [0] * EPISODES for name in ("chunk", "file")}
    counter = {"dtype": "int64", "shape": [1], "names": None}
    features = {"observation.images.front": IMAGE, "observation.images.wrist": IMAGE}
    features |= {"observation.state": VECTOR, "action": VECTOR}
    info = {"codebase_version": "v3.0", "fps": 10, "features": {**features, "episode_index": counter}}
    info["data_path"] = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
    for folder in ("data/chunk-000", "meta/episodes/chunk-000"):
        (root / folder).mkdir(parents=True)
    pq.write_table(pa.Table.from_pylist(rows), root / "data/chunk-000/file-000.parquet")
    pq.write_table(pa.table(episodes), root / "meta/episodes/chunk-000/file-000.parquet")
    pq.write_table(pa.table({"task_index": [0], "task": ["tidy"]}), root / "meta/tasks.parquet")
    (root / "meta/info.json").write_text(json.dumps(info))
    return orders


@pytest.mark.parametrize("shell", [{"segmentation": 30, "imitation": 60}], indirect=True)
def test_a_lerobot_dataset_becomes_endpoints_and_its_robot_follows(
    shell: Shell, read_blocks: Callable[[str, str], list[str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    orders = record(tmp_path / "recorded")
    lines = [f"{index},{';'.join(SKILLS[skill] for skill in order)}" for index, order in enumerate(orders)]
    (tmp_path / "tags.csv").write_text("\n".join(["trajectory,skills", *lines]))
    segmentation, policy, with_state = read_blocks("lerobot", "sh")
    scale, loop, _ = read_blocks("lerobot", "python")
    monkeypatch.chdir(tmp_path)

    said = shell(segmentation)
    assert "Of the cameras front, wrist, the model sees front; another is chosen by --set cameras=wrist." in said
    exec(scale, {})
    printed = shell(policy)

    exported = pq.read_table(tmp_path / "recorded/data/chunk-000/file-000.parquet")["language_persistent"]
    root = tmp_path / "var/datasets/arm"
    first = labels.labels(root, 0)[0]
    assert (exported[0][0]["style"].as_py(), exported[0][0]["content"].as_py()) == ("subtask", SKILLS[first])
    assert labels.info(root).skills == SKILLS
    assert list(map(len, labels.all_labels(root, Dataset(root).lengths))) == [STEPS * len(order) for order in orders]
    np.testing.assert_array_equal(Dataset(root).robot_state(3), Dataset(root).actions(3))  # as recorded above
    scaled = Dataset(tmp_path / "var/datasets/arm-scaled")
    np.testing.assert_allclose(LOW + (scaled.actions(3) + 1) / 2 * (HIGH - LOW), Dataset(root).actions(3), atol=1e-4)
    np.testing.assert_array_equal(scaled.robot_state(3), Dataset(root).robot_state(3))
    assert "2 numbers, read by `use_robot_state`" in printed

    names, address = dict[str, Any](), os.environ["FREEREIN_IMITATION_ADDRESS"]
    exec(loop, names)
    first, second = np.array([52.0, 40.0]), np.array([76.0, 56.0])
    for start, goal in ((first, second), (second, first)):
        arm = Arm(start)
        assert names["follow"](arm, drawn(goal, 0), LOW, HIGH, fps=1000, address=address) in (True, False)
        towards = moved(start, [arm.sent[0][name] for name in JOINTS]) - start
        assert towards @ (goal - start) > 0

    assert "2 numbers" in shell(with_state)
    PIL.Image.fromarray(drawn(first, 1)).resize((64, 48)).save(tmp_path / "now.png")
    acted = shell("freerein act --image now.png --recipe reach --robot-state=-12.5,40 --json")
    assert json.loads(acted)["actions"]["shape"][1] == len(JOINTS)
