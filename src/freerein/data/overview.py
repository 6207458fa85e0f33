"""A dataset at a glance, as lists of datasets show it: nothing that takes long to read."""

from collections import Counter
from contextlib import suppress
from pathlib import Path

from freerein.data import hand_labels, labels, truth
from freerein.data.reader import Dataset
from freerein.errors import FailedPrecondition, InvalidInput, ServiceError
from freerein.types import orchestrator
from freerein.types.common import Camera, ModelRef


def overview(root: Path) -> orchestrator.Dataset:
    """Returns what is known of a dataset without its data files; why it cannot be opened where it is damaged."""
    try:
        return _opened(root)
    except ServiceError as error:
        return orchestrator.Dataset(root.name, error=f"{error.detail} {error.hint}".strip())
    except OSError as error:  # such as of one that is being deleted
        return orchestrator.Dataset(root.name, error=f"It cannot be read: {error.strerror}.")


def _opened(root: Path) -> orchestrator.Dataset:
    dataset = Dataset(root)
    spec = dataset.spec
    return orchestrator.Dataset(
        name=root.name,
        goal_text=spec.task,
        cameras=tuple(Camera(name, *size) for name, size in spec.cameras.items()),
        fps=spec.fps,
        action=spec.action,
        skills=spec.skills,
        tags=dict(Counter(skill for skills in dataset.skills for skill in skills)),
        trajectories=len(dataset),
        timesteps=int(dataset.lengths.sum()),
        labelled_by=_labelled_by(root),
        hand_labelled=hand_labels.count(root),
        with_truth=len(truth.labelled(root)),
        time_ns=(root / "meta").stat().st_mtime_ns,
    )


def _labelled_by(root: Path) -> ModelRef | None:
    with suppress(FailedPrecondition, InvalidInput):
        return labels.info(root).model
    return None
