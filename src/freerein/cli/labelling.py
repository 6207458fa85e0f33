"""Labels a whole dataset by the segmentation service, and keeps the labels beside it."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from freerein.clients import SegmentationClient
from freerein.data import Dataset, labels
from freerein.types.segmentation import ListSkillsRequest, SegmentRequest


async def label_all(
    client: SegmentationClient,
    root: Path,
    request: SegmentRequest,
    *,
    camera: str,
    on_count: Callable[[int], None],
) -> labels.LabelsInfo:
    """Writes the labels of every trajectory of a dataset, made by one version of one model.

    Until all are written, none count: a dataset is labelled or not.

    Args:
        client: The segmentation service.
        root: Where the dataset lies.
        request: How to label; each trajectory is put into it.
        camera: Whose frames.
        on_count: Called with the number of trajectories labelled.

    Returns:
        What the labels are.

    Raises:
        ServiceError: The service refused a trajectory, or the dataset cannot be read.
    """
    dataset = Dataset(root)
    skills = await client.list_skills(ListSkillsRequest(request.model))
    labels.discard(root)
    for index, trajectory in enumerate(dataset):
        frames, actions = trajectory.frames[camera], trajectory.actions
        answer = await client.segment(replace(request, model=skills.model, frames=frames, actions=actions))
        labels.save(root, index, answer.labels)
        on_count(index + 1)
    info = labels.LabelsInfo(skills.skills, skills.model)
    labels.finish(root, info)
    return info
