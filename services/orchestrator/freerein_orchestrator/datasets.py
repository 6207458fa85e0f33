"""`DatasetService`: the datasets of the data directory for people who look at them, and labels that they give.

Frames are small pictures, a page at a time. True labels are counted, never read.
"""

import asyncio
import io
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

import numpy as np
import numpy.typing as npt
import PIL.Image

from freerein.data import Dataset, check, dataset_path, hand_labels, labels
from freerein.data.label_segments import to_segments
from freerein.data.lookup import choose_camera, dataset_names, open_dataset
from freerein.data.overview import overview
from freerein.errors import FailedPrecondition, InvalidInput, NotFound, must_be
from freerein.types import orchestrator
from freerein.types.common import Image
from freerein.types.orchestrator import LabelSegment

T = TypeVar("T")

_PAGE, _LARGEST_PAGE = 100, 1000
_FRAMES, _MOST_FRAMES, _MOST_PIXELS = 32, 64, 2**25
_SIDE, _LEAST_SIDE, _GREATEST_SIDE = 256, 16, 1024
_MOST_NUMBERS = 100_000
_JPEG = {"quality": 90, "subsampling": 0}  # colours as fine as brightness: frames are small, and shown large
_THREADS = 2


class DatasetService:
    """The datasets of one data directory."""

    def __init__(self, data_dir: Path) -> None:
        self._data_dir = data_dir
        self._threads = ThreadPoolExecutor(_THREADS, "datasets")
        self._checking = ThreadPoolExecutor(1, "checks")  # which may take minutes

    def close(self) -> None:
        """Begins no further call."""
        for threads in (self._threads, self._checking):
            threads.shutdown(wait=False, cancel_futures=True)

    async def list_datasets(self, request: orchestrator.ListDatasetsRequest) -> orchestrator.ListDatasetsResponse:
        """Returns one page of the datasets, by name. Raises InvalidInput when the page is too large."""
        size = request.page_size or _PAGE
        if size > _LARGEST_PAGE:
            raise must_be("page_size", f"at most {_LARGEST_PAGE}", size, hint="Ask for several pages.")

        def page() -> orchestrator.ListDatasetsResponse:
            names = [name for name in dataset_names(self._data_dir) if name > request.page_token]
            found = tuple(overview(dataset_path(self._data_dir, name)) for name in names[:size])
            return orchestrator.ListDatasetsResponse(found, names[size - 1] if len(names) > size else "")

        return await _in_thread(self._threads, page)

    async def list_dataset_problems(
        self, request: orchestrator.ListDatasetProblemsRequest
    ) -> orchestrator.ListDatasetProblemsResponse:
        """Returns what prevents or impairs learning skills. Raises NotFound, or InvalidInput where it is damaged."""

        def problems() -> orchestrator.ListDatasetProblemsResponse:
            open_dataset(self._data_dir, request.dataset)
            found = check(dataset_path(self._data_dir, request.dataset))
            return orchestrator.ListDatasetProblemsResponse(
                tuple(
                    orchestrator.DatasetProblem(each.where, each.sentence, each.hint, each.severity) for each in found
                )
            )

        return await _in_thread(self._checking, problems)

    async def get_trajectory(self, request: orchestrator.GetTrajectoryRequest) -> orchestrator.GetTrajectoryResponse:
        """Returns one trajectory. Raises NotFound, or InvalidInput where it is damaged."""

        def trajectory() -> orchestrator.GetTrajectoryResponse:
            dataset, root = self._open(request.dataset, request.index), self._root(request.dataset)
            timesteps = int(dataset.lengths[request.index])
            is_small = 0 < timesteps * dataset.spec.action.size <= _MOST_NUMBERS
            return orchestrator.GetTrajectoryResponse(
                skills=dataset.skills[request.index],
                goal_text=dataset.goal_texts[request.index],
                timesteps=timesteps,
                labels=_predicted(root, request.index, timesteps),
                hand_labels=hand_labels.read(root, dataset, request.index),
                known_skills=_known_skills(root, dataset),
                actions=dataset.actions(request.index) if is_small else None,
            )

        return await _in_thread(self._threads, trajectory)

    async def get_frames(self, request: orchestrator.GetFramesRequest) -> orchestrator.GetFramesResponse:
        """Returns some frames of a trajectory. Raises NotFound, or InvalidInput for a timestep that is not there."""
        count, side = request.count or _FRAMES, request.max_side or _SIDE
        if count > _MOST_FRAMES:
            raise must_be("count", f"at most {_MOST_FRAMES}", count, hint="Ask for several pages.")
        if not _LEAST_SIDE <= side <= _GREATEST_SIDE:
            hint = "Frames are only scaled down; leave it out for a small picture."
            raise must_be("max_side", f"{_LEAST_SIDE} to {_GREATEST_SIDE} pixels", side, hint=hint)

        def frames() -> orchestrator.GetFramesResponse:
            dataset = self._open(request.dataset, request.index)
            timesteps = int(dataset.lengths[request.index])
            if request.first >= timesteps:
                hint = "Timesteps are counted from 0."
                raise must_be("first", f"below {timesteps}, the trajectory's timesteps", request.first, hint=hint)
            camera = choose_camera(dataset, request.camera, of_model=next(iter(dataset.spec.cameras)))
            height, width, _ = dataset.spec.cameras[camera]
            part = slice(request.first, request.first + min(count, max(1, _MOST_PIXELS // (height * width))))
            pixels = dataset.frames(request.index, camera, part, size=_scaled_down(height, width, side))
            pictures = tuple(_picture(each, camera) for each in pixels)
            return orchestrator.GetFramesResponse(pictures, request.first, timesteps)

        return await _in_thread(self._threads, frames)

    async def save_labels(self, request: orchestrator.SaveLabelsRequest) -> orchestrator.SaveLabelsResponse:
        """Saves labels that a person gave.

        Raises:
            NotFound: There is no such dataset or trajectory.
            InvalidInput: Segments overlap or leave a gap, or have an unknown skill.
            FailedPrecondition: The dataset is being written.
        """

        def save() -> orchestrator.SaveLabelsResponse:
            dataset, root = self._open(request.dataset, request.index), self._root(request.dataset)
            hand_labels.save(root, request.index, request.segments, known=_known_skills(root, dataset))
            return orchestrator.SaveLabelsResponse()

        return await _in_thread(self._threads, save)

    def _root(self, name: str) -> Path:
        return dataset_path(self._data_dir, name)

    def _open(self, name: str, index: int) -> Dataset:
        """Opens a dataset that has a trajectory of this index."""
        dataset = open_dataset(self._data_dir, name)
        if index >= len(dataset):
            raise NotFound(
                f"`index` must be below {len(dataset)}, the number of trajectories; got {index}.",
                field="index",
                hint="Trajectories are counted from 0.",
            )
        return dataset


async def _in_thread(threads: ThreadPoolExecutor, call: Callable[[], T]) -> T:
    return await asyncio.get_running_loop().run_in_executor(threads, call)


def _predicted(root: Path, index: int, timesteps: int) -> tuple[LabelSegment, ...]:
    """Returns the labels of a segmentation model; empty where it has not labelled this trajectory."""
    try:
        skills = labels.info(root).skills
        return tuple(to_segments(labels.checked_labels(root, index, timesteps=timesteps, skills=skills), skills))
    except FailedPrecondition:
        return ()


def _known_skills(root: Path, dataset: Dataset) -> tuple[str, ...]:
    """Returns the names that labels may have: the dataset's skills, then others of the model that labelled it."""
    try:
        of_model = labels.info(root).skills
    except (FailedPrecondition, InvalidInput):
        of_model = ()
    return tuple(dict.fromkeys((*dataset.spec.skills, *of_model)))


def _scaled_down(height: int, width: int, side: int) -> tuple[int, int] | None:
    """Returns a height and width of at most `side` in the same proportions; None where they are not above it."""
    ratio = side / max(height, width)
    return (max(1, round(height * ratio)), max(1, round(width * ratio))) if ratio < 1 else None


def _picture(pixels: npt.NDArray[np.uint8], camera: str) -> Image:
    """Returns a frame (H, W, C) as a JPEG file: forty times as fast as WebP, which takes a third of the bytes."""
    height, width, channels = pixels.shape
    buffer = io.BytesIO()
    PIL.Image.fromarray(pixels[:, :, 0] if channels == 1 else pixels).save(buffer, "JPEG", **_JPEG)
    return Image("jpeg", height, width, buffer.getvalue(), camera)
