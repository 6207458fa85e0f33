"""The teachers that ship, under `models/orchestrator`, each by the name of its task.

`python -m experiments.chapter4.shipped_teachers` publishes there the policies of `teachers` that have been trained.
A second run changes nothing.
"""

import argparse
import os
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from experiments import registry
from experiments.teachers import TASKS
from experiments.workbench.pipelines import run_folder
from experiments.workbench.runner import Places, arm_folder
from freerein.atomic_files import make_folder
from freerein.learning.actor_critic.policy_files import IN_DISTRIBUTION_FILE, NAMES
from freerein.learning.model_files import read_card
from freerein.model_store import CLONE_MODELS, ModelStore
from freerein.types.common import ModelRef

_EXPERIMENT, _STEP = "teachers", "ppo"
_FILES = (NAMES.weights, IN_DISTRIBUTION_FILE, NAMES.card)


@dataclass(frozen=True)
class Teacher:
    """A teacher: its task, which is its name among the models, and the sha256 of its weights."""

    task: str
    sha256: str


def shipped_teachers() -> tuple[Teacher, ...]:
    """Returns the teachers that ship, or those in `FREEREIN_SHIPPED_DIR`, in the order of the tasks."""
    store = ModelStore(_folder())
    refs = [ModelRef(task, version) for task in TASKS if (version := store.active_version(task))]
    return tuple(Teacher(ref.name, read_card(store.folder(ref), names=NAMES)["sha256"]) for ref in refs)


def publish(work: Path) -> Iterator[ModelRef]:
    """Yields the versions of teachers that were trained in a work folder, once they are among the shipped models."""
    experiment, store = registry.load(_EXPERIMENT), ModelStore(_folder())
    make_folder(_folder())
    for arm in experiment.arms:
        folder = arm_folder(_EXPERIMENT, experiment, arm, Places(work=work))
        made = run_folder(folder) / "parts" / _STEP / "artifacts"
        if not (made / NAMES.card).is_file():
            continue
        with tempfile.TemporaryDirectory(dir=_folder().parent) as staging:
            copy = Path(staging) / arm.world
            copy.mkdir()
            for name in _FILES:
                shutil.copyfile(made / name, copy / name)
            ref = store.publish(arm.world, copy)
        store.activate(ref)
        yield ref


def _folder() -> Path:
    return Path(os.environ.get("FREEREIN_SHIPPED_DIR") or CLONE_MODELS) / "orchestrator"


def main() -> None:
    """Publishes what is done, and prints it."""
    parser = argparse.ArgumentParser(description="Put trained teachers among the models that ship.")
    parser.add_argument("--work", type=Path, default=Places.work, help="folder of the arms")
    for ref in publish(parser.parse_args().work):
        print(ref.name, ref.version)


if __name__ == "__main__":
    main()
