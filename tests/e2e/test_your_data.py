"""The blocks of docs/your-data.md, as a user runs them, on images that no simulator of ours has drawn."""

import json
import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import PIL.Image
import PIL.ImageDraw
import pytest

from freerein.data import Dataset, labels
from freerein.metrics import frame_accuracy
from freerein.relations import SpatialRelation, classify_relation

RED, BLUE, GRAY = (215, 30, 30), (30, 70, 220), (120, 124, 130)
SIDE, STEPS, SKILLS = 32, 12, ("pour", "reach")

pytestmark = pytest.mark.e2e
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
def block_with(read_blocks: Callable[[str, str], list[str]]) -> Callable[[str], str]:
    """Returns the block with a text."""

    def found(text: str) -> str:
        (block,) = (each for each in read_blocks("your-data", "sh") if text in each)
        return block

    return found


@pytest.mark.parametrize("shell", [{"segmentation": 60}], indirect=True)
def test_recordings_and_tags_say_which_skill_when(shell: Shell, block_with: Shell, tmp_path: Path) -> None:
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


@pytest.mark.parametrize("shell", [{"reward": 100}], indirect=True)
def test_images_and_phrases_become_rewards(shell: Shell, block_with: Shell, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)

    def scene(path: Path) -> npt.NDArray[np.float64]:
        """Draws two discs in one of the five relations; returns their middles, as fractions of the width."""
        first = rng.uniform((35, 30), (60, 66))
        turned = rng.choice([0, 90, 180, 270]) + rng.uniform(-10, 10)
        far = rng.choice([16.0, 16.0, 16.0, 34.0])
        second = first + far * np.array([np.cos(np.radians(turned)), np.sin(np.radians(turned))])
        draw(path, [(*first, RED), (*second, BLUE)], radius=6, size=(96, 96))
        return np.stack([first, second]) / 96

    for index in range(160):
        scene(tmp_path / "photos" / f"{index}.png")
    held_out = [scene(tmp_path / "held-out" / f"{index:02d}.png") for index in range(60)]

    printed = shell(block_with("fit reward --images"))
    assert "a red ball on top of a blue ball" in printed  # the goal text of curl, as it was read

    goal = '--goal "the red ball is to the left of the blue ball"'
    answer = json.loads(shell(f"freerein reward held-out {goal} --json"))
    middles = np.array(held_out)
    relations = classify_relation(middles[:, 0], middles[:, 1], epsilon=0.12)
    rewarded, is_left = np.array(answer["rewards"]) == 1, relations == SpatialRelation.LEFT_OF
    assert rewarded[is_left].mean() > 0.6
    assert rewarded[~is_left].mean() < 0.15


@pytest.mark.parametrize("shell", [{"imitation": 80}], indirect=True)
def test_exploration_becomes_a_policy(shell: Shell, block_with: Shell, tmp_path: Path) -> None:
    """A disc moves by its action, which is another one in each trajectory."""
    rng = np.random.default_rng(2)
    for index in range(40):
        action = np.array([1, -0.5]) if index == 0 else rng.uniform(-1, 1, size=2)
        middle = SIDE / 2 + rng.uniform(-2, 2, size=2)
        for t in range(STEPS):
            draw(tmp_path / "play" / str(index) / f"{t}.png", [(*(middle + (t - STEPS / 2) * action), RED)])
        table = np.tile(action, (STEPS, 1))
        np.savetxt(tmp_path / "play" / str(index) / "actions.csv", table, delimiter=",", header="dx,dy", comments="")
    block = block_with("--recordings play")
    back = re.sub(r"\d(?=\.png)", lambda digit: {"0": "9", "9": "0"}[digit[0]], block.splitlines()[-1])

    answers = shell(block), shell(back)

    for printed, signs in zip(answers, ([1, -1], [-1, 1]), strict=True):
        (action,) = json.loads(printed.splitlines()[-1])["actions"]
        assert np.sign(action).tolist() == signs
