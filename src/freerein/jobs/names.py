"""Readable names of fits and runs, such as `ppo-yellow-left-of-green-8bc1f7`: beside the id, which remains their id.

<data directory>/named/<name>   a link to the job's folder; those of deleted jobs are removed
"""

import os
import re
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

LINKS = "named"
_MAX_SUBJECT, _DIGITS = 64, 6


def job_name(kind: str, config: Mapping[str, Any]) -> str:
    """Returns the kind of a run, or service of a fit, with what it is about: dataset, task without world, or model."""
    task = str(config.get("task", "")).rpartition(".")[2]
    dataset = "" if kind == "ppo" else config.get("dataset")  # of a ppo run it has examples of the task
    subject = str(dataset or task or config.get("model_name", ""))
    own = re.sub(r"[^a-z0-9]+", "-", subject.lower()).strip("-")[:_MAX_SUBJECT]
    return f"{kind}-{own}" if own else kind


def link_by_name(links: Path, folder: Path, name: str) -> None:
    """Makes the link to a job's folder, and removes those of deleted jobs; without it the job is still there."""
    with suppress(OSError):
        links.mkdir(exist_ok=True)
        remove_broken(links)
        target = os.path.relpath(folder, links)
        (links / f"{name}-{folder.name[:_DIGITS]}").symlink_to(target, target_is_directory=True)


def remove_broken(links: Path) -> None:
    """Removes the links to deleted jobs."""
    with suppress(OSError):
        for link in links.iterdir():
            if link.is_symlink() and not link.exists():
                link.unlink()
