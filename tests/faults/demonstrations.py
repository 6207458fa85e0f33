"""A small dataset that the faulty service's fits learn from."""

from pathlib import Path

import numpy as np

from freerein.data import DatasetSpec, create
from freerein.types.common import ActionSpec, Trajectory


def record_demonstrations(data_dir: Path) -> None:
    """Records `demos`: six trajectories of noise, in each of which both skills occur."""
    rng, skills = np.random.default_rng(0), ("close", "open")
    spec = DatasetSpec(10, {"front": (16, 16, 3)}, ActionSpec(2, 0, ("x", "y")), "none", skills)
    with create(data_dir / "datasets" / "demos", spec) as writer:
        for _ in range(6):
            frames = {"front": rng.integers(0, 255, (8, 16, 16, 3), np.uint8)}
            writer.append(Trajectory(frames, np.zeros((8, 2), np.float32), skills))
