"""Paths of what is kept in the work folder, such as datasets and checkpoints, found by what makes it.

    <folder>/<name>.json   what makes it: everything that it depends on
             <name>...     what it made

A configuration that has only gained keys with defaults finds what it made before; see `configs.is_same`.
"""

import hashlib
import json
from pathlib import Path

from experiments.workbench.configs import Config, is_same, to_json
from experiments.workbench.locks import locked
from freerein.atomic_files import write_atomic


def cache_path(folder: Path, made_by: Config, *, prefix: str = "") -> Path:
    """Returns the path of what a configuration makes; it may not have been made yet.

    Args:
        folder: Where the path is; it is made.
        made_by: Everything that it depends on.
        prefix: What its name begins with.
    """
    with locked(folder / "lock"):
        for path in sorted(folder.glob(f"{prefix}*.json")):
            if is_same(json.loads(path.read_bytes()), made_by):
                return path.with_name(path.name.removesuffix(".json"))
        written = json.dumps(to_json(made_by), sort_keys=True).encode()
        name = f"{prefix}{hashlib.sha256(written).hexdigest()[:16]}"
        write_atomic(folder / f"{name}.json", written)
        return folder / name
