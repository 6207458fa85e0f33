"""Writes a dataset as a LeRobotDataset v3 of its own, for programs that know nothing of freerein.

data/                      frames as PNG, actions, states: the very files of the dataset
meta/                      LeRobot's index and statistics; `freerein.json` has the exact control period
labels/, teachers.json     as in the dataset, where it has them
"""

import hashlib
import shutil
from pathlib import Path

from freerein.atomic_files import new_folder, write_atomic
from freerein.data import layout, meta
from freerein.errors import InvalidInput, NotFound

_LABELS = "labels"


def export_lerobot(root: Path, folder: Path) -> int:
    """Writes a dataset to a folder that LeRobot opens, and freerein imports.

    Ground truth of the worlds, labels that people gave, what teachers see and their reward model judged, and what can
    be made again are left out.

    Args:
        root: The dataset's folder.
        folder: Written; new or empty.

    Returns:
        The number of episodes.

    Raises:
        AlreadyExists: The folder to write is not empty.
        NotFound: There is no dataset of freerein with trajectories.
        InvalidInput: A data file is missing or damaged.
    """
    spec = meta.read_spec(root)
    table = meta.load(root, spec)[0] if spec else None
    if spec is None or not table:
        raise NotFound(
            "A dataset to export must have trajectories that freerein wrote; there are none.",
            hint="`freerein dataset list` names all.",
        )
    with new_folder(folder) as written:
        for index, sha256 in enumerate(table["data/sha256"].to_pylist()):
            data = meta.read_data_file(root, index)
            if hashlib.sha256(data).hexdigest() != sha256:
                raise InvalidInput(
                    f"Trajectory {index} must be as it was recorded; its file has changed.",
                    hint="`freerein dataset verify NAME` lists what is damaged.",
                )
            write_atomic(layout.trajectory_path(written / "data", index), data)
        meta.save(written, spec, table)
        if (root / _LABELS).is_dir():
            shutil.copytree(root / _LABELS, written / _LABELS)
        if (root / layout.TEACHERS_FILE).is_file():
            shutil.copyfile(root / layout.TEACHERS_FILE, written / layout.TEACHERS_FILE)
    return len(table)
