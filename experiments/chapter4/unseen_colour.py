"""Whether a student's training shows or names anything in the colour of the test tasks."""

import json
from pathlib import Path

import numpy as np
import numpy.typing as npt

from experiments.chapter4.tasks import TEST_COLOUR
from freerein.atomic_files import write_atomic
from freerein.data import Dataset
from freerein.errors import FailedPrecondition

_LEAST_SATURATION, _LEAST_VALUE = 0.4, 0.15
"""The wall is blueish, too, at a saturation of 0.2; the block's is 0.9."""

_FILE = "unseen.json"


def blue_pixels(frames: npt.NDArray[np.uint8]) -> int:
    """Returns how many pixels of frames, uint8 (..., 3), are blue: saturated, and of more blue than all else."""
    pixels = frames.reshape(-1, 3).astype(np.float32) / 255
    value, chroma = pixels.max(axis=1), np.ptp(pixels, axis=1)
    is_blue = (pixels[:, 2] > pixels[:, :2].max(axis=1)) & (chroma > _LEAST_SATURATION * value) & (value > _LEAST_VALUE)
    return int(is_blue.sum())


def check_unseen(root: Path, folder: Path) -> None:
    """Scans a whole dataset, once.

    Args:
        root: Folder of the dataset.
        folder: Where the result lies.

    Raises:
        FailedPrecondition: A frame shows the colour, or a goal text names it.
    """
    if not (folder / _FILE).is_file():
        dataset = Dataset(root)
        pixels = sum(blue_pixels(each) for trajectory in dataset for each in trajectory.frames.values())
        texts = sum(TEST_COLOUR in text for text in dataset.goal_texts)
        found: dict[str, float] = {"timesteps": int(dataset.lengths.sum()), "pixels": pixels, "texts": texts}
        write_atomic(folder / _FILE, json.dumps(found).encode())
    found = scanned(folder)
    if found["pixels"] or found["texts"]:
        raise FailedPrecondition(
            f"Nothing that a student learns from may be {TEST_COLOUR}; {found['pixels']:.0f} pixels and "
            f"{found['texts']:.0f} texts are.",
            hint="Take teachers of the training tasks alone.",
        )


def scanned(folder: Path) -> dict[str, float]:
    """Returns what a scan has found: timesteps, and pixels and texts of the colour."""
    return dict(json.loads((folder / _FILE).read_bytes()))
