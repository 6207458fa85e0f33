"""A gray camera of 120 x 320 pixels, as of another package: from demonstrations to labels."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from freerein.data import Dataset, dataset_path, labels

pytestmark = pytest.mark.e2e
MODULE = """
from dataclasses import replace
from functools import partial

from freerein.types.common import Camera
from freerein_sim.worlds import blocks

COLOURED = blocks.TASKS[0]
SPEC = replace(COLOURED.spec, cameras=(Camera("front", 120, 320, 1),))
TASKS = (replace(COLOURED, name="gray", spec=SPEC, make=partial(COLOURED.make.func, SPEC)),)
"""


@pytest.fixture
def packages(tmp_path: Path) -> str:
    """A folder with a package that offers the task `gray`."""
    info = tmp_path / "packages" / "gray_world-1.0.dist-info"
    info.mkdir(parents=True)
    (info.parent / "gray_world.py").write_text(MODULE)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: gray_world\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[freerein.worlds]\ngray_world = gray_world:TASKS\n")
    return str(info.parent)


def test_gray_and_wide_frames_are_collected_fitted_and_labelled(
    new_run: Callable[..., Any], start_service: Callable[..., Any], packages: str, tmp_path: Path
) -> None:
    sim = start_service("freerein_sim", FREEREIN_SIM_WORKERS="1", PYTHONPATH=packages)
    segmentation = start_service("freerein_segmentation", tmp_path)
    demos = {"task": "gray", "dataset": "demos", "count": 2, "max_skills": 2}
    steps = [
        {"name": "demos", "kind": "collect", "config": demos},
        {
            "name": "fit",
            "kind": "fit",
            "config": {
                "service": "segmentation",
                "dataset": "demos",
                "model_name": "gray",
                "config": {"steps": 1, "batch_size": 1, "features": 8, "hidden_size": 8},
            },
        },
        {"name": "label", "kind": "label", "config": {"dataset": "demos", "model": "gray"}},
    ]
    addresses = {"FREEREIN_SIM_ADDRESS": sim.address, "FREEREIN_SEGMENTATION_ADDRESS": segmentation.address}
    assert new_run(tmp_path, "pipeline", {"steps": steps}, **addresses).do()

    root = dataset_path(tmp_path, "demos")
    seen = Dataset(root)[0].frames["front"]
    assert seen.shape[1:] == (120, 320, 1)
    assert seen.std() > 10
    assert len(labels.labels(root, 0)) == len(seen)
