"""The blocks of docs/your-data.md, as a user runs them, on images that no simulator of ours has drawn."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import PIL.Image
import PIL.ImageDraw
import pytest

from freerein.data import Dataset, labels
from freerein.metrics import frame_accuracy
from freerein_reward.relations import SpatialRelation, classify_relation

PAGE = Path(__file__).parents[2] / "docs" / "your-data.md"
BLOCKS = re.findall(r"^```sh\n(.*?)^```", PAGE.read_text(), re.MULTILINE | re.DOTALL)
PORTS = {"segmentation": 8101, "imitation": 8102, "reward": 8103}
RED, BLUE, GRAY = (215, 30, 30), (30, 70, 220), (120, 124, 130)
SMALL = {  # so that a fit takes seconds
    "segmentation": ("steps=60", "features=8", "hidden_size=16", "lr=0.01", "augmentation=0", "evaluate_every=20"),
    "reward": ("steps=120", "batch_size=32", "augmentation=0", "evaluate_every=40"),
    "imitation": ("steps=50", "batch_size=8", "features=16", "hidden_size=32", "embedding_size=4"),
}
SIDE, STEPS, SKILLS = 32, 12, ("pour", "reach")

pytestmark = [pytest.mark.e2e, pytest.mark.slow, pytest.mark.timeout(600)]
Discs = Sequence[tuple[float, float, tuple[int, int, int]]]
Shell = Callable[[str], str]


def draw(path: Path, discs: Discs, *, radius: float = 3, size: tuple[int, int] = (SIDE, SIDE)) -> None:
    """Draws discs, x and y of each one's middle, on gray."""
    path.parent.mkdir(parents=True, exist_ok=True)
    image = PIL.Image.new("RGB", size, GRAY)
    for x, y, colour in discs:
        PIL.ImageDraw.Draw(image).ellipse((x - radius, y - radius, x + radius, y + radius), fill=colour)
    image.save(path)


@pytest.fixture
def shell(request: pytest.FixtureRequest, start_service: Callable[..., Any], tmp_path: Path) -> Shell:
    """Runs a block with the service that the test names, and small fits; returns what it printed."""
    name = request.param
    service = start_service(f"freerein_{name}", tmp_path / "var", FREEREIN_SHIPPED_DIR=str(PAGE.parents[1] / "models"))
    own = {"FREEREIN_DATA_DIR": str(tmp_path / "var"), f"FREEREIN_{name.upper()}_ADDRESS": service.address}
    environ = {**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}", **own}
    options = "".join(f" --set {each}" for each in SMALL[name])

    def run(block: str) -> str:
        block = block.replace(f"localhost:{PORTS[name]}", f"127.0.0.1:{service.http_port}")
        command = ["bash", "-euo", "pipefail", "-c", block.replace(" --watch", f" --watch{options}")]
        ran = subprocess.run(command, cwd=tmp_path, env=environ, capture_output=True, text=True, check=False)
        assert ran.returncode == 0, f"{block}\n{ran.stdout}\n{ran.stderr}"
        return ran.stdout

    return run


def block_with(text: str) -> str:
    (block,) = (each for each in BLOCKS if text in each)
    return str(block)


@pytest.mark.parametrize("shell", ["segmentation"], indirect=True)
def test_recordings_and_tags_say_which_skill_when(shell: Shell, tmp_path: Path) -> None:
    """A red disc moves in one skill, a blue one in the other; there are no actions."""
    rng, truth, lines = np.random.default_rng(0), list[int](), ["trajectory,skills"]
    for take in range(1, 41):
        order = [(0,), (1,), (0, 1), (1, 0)][take % 4]
        skills = np.repeat(order, rng.integers(4, 8, size=len(order)))
        for t, skill in enumerate(skills):
            place = (6 + 3 * (t % 7), rng.uniform(8, 24))
            draw(tmp_path / "recordings" / f"take-{take}" / f"{t}.png", [(*place, (RED, BLUE)[skill])])
        truth += skills.tolist()
        lines.append(f"take-{take},{';'.join(SKILLS[skill] for skill in order)}")
    (tmp_path / "recordings" / "tags.csv").write_text("\n".join(lines))

    printed = shell(block_with("dataset import recordings"))

    root = tmp_path / "var" / "datasets" / "kitchen"
    predicted = np.concatenate(labels.all_labels(root, Dataset(root).lengths))
    assert labels.info(root).skills == SKILLS
    assert frame_accuracy(predicted, np.array(truth)) > 0.8  # a guess among each take's skills: two in three
    assert json.loads(printed.splitlines()[-1])["labels"] == truth[:2]


@pytest.mark.parametrize("shell", ["reward"], indirect=True)
def test_images_and_phrases_become_rewards(shell: Shell, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)

    def scene(path: Path) -> npt.NDArray[np.float64]:
        """Draws two discs in one of the five relations; returns their middles, as fractions of the width."""
        first = rng.uniform((35, 30), (60, 66))
        turned = rng.choice([0, 90, 180, 270]) + rng.uniform(-10, 10)
        far = rng.choice([16.0, 16.0, 16.0, 34.0])
        second = first + far * np.array([np.cos(np.radians(turned)), np.sin(np.radians(turned))])
        draw(path, [(*first, RED), (*second, BLUE)], radius=6, size=(96, 96))
        return np.stack([first, second]) / 96

    for index in range(200):
        scene(tmp_path / "photos" / f"{index}.png")
    held_out = [scene(tmp_path / "held-out" / f"{index:02d}.png") for index in range(80)]

    printed = shell(block_with("fit reward --images"))
    assert "a red ball on top of a blue ball" in printed  # the goal text of curl, as it was read

    goal = '--goal "the red ball is to the left of the blue ball"'
    answer = json.loads(shell(f"freerein reward held-out {goal} --json"))
    middles = np.array(held_out)
    relations = classify_relation(middles[:, 0], middles[:, 1], epsilon=0.12)
    rewarded, is_left = np.array(answer["rewards"]) == 1, relations == SpatialRelation.LEFT_OF
    assert rewarded[is_left].mean() > 0.6
    assert rewarded[~is_left].mean() < 0.15


@pytest.mark.parametrize("shell", ["imitation"], indirect=True)
def test_exploration_becomes_a_policy(shell: Shell, tmp_path: Path) -> None:
    """A disc moves by its action, which is another one in each trajectory."""
    rng = np.random.default_rng(2)
    for index in range(40):
        action = np.array([1, -0.5]) if index == 0 else rng.uniform(-1, 1, size=2)
        middle = SIDE / 2 + rng.uniform(-2, 2, size=2)
        for t in range(STEPS):
            draw(tmp_path / "play" / str(index) / f"{t}.png", [(*(middle + (t - STEPS / 2) * action), RED)])
        table = np.tile(action, (STEPS, 1))
        np.savetxt(tmp_path / "play" / str(index) / "actions.csv", table, delimiter=",", header="dx,dy", comments="")
    block = block_with("dataset import play")
    back = re.sub(r"\d(?=\.png)", lambda digit: {"0": "9", "9": "0"}[digit[0]], block.splitlines()[-1])

    answers = shell(block), shell(back)

    for printed, signs in zip(answers, ([1, -1], [-1, 1]), strict=True):
        (action,) = json.loads(printed.splitlines()[-1])["actions"]
        assert np.sign(action).tolist() == signs
