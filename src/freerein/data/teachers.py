"""Whom a dataset's trajectories are of, where policies acted in them: `<root>/teachers.json`, beside what they did.

Each teacher is an object, of which a learner reads `supervision`, what taught the policy, in words, and `privileged`,
whether that saw what no learner may see.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from freerein.atomic_files import write_atomic

_FILE = "teachers.json"


def save(root: Path, teachers: Sequence[Mapping[str, Any]]) -> None:
    """Writes, durably, what is told of the policies that acted."""
    write_atomic(root / _FILE, json.dumps(list(teachers), indent=2).encode() + b"\n")


def read(root: Path) -> list[dict[str, Any]]:
    """Returns what is told of the policies that acted; nothing where none did, as in demonstrations."""
    path = root / _FILE
    return list(json.loads(path.read_bytes())) if path.is_file() else []
