"""The trajectories of a LeRobotDataset v3, as they are imported: what is left out is noted."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from freerein.data.annotations import read_tags
from freerein.data.importing import Recorded, Source
from freerein.data.lerobot_features import DEFAULTS, LeRobotOptions
from freerein.data.meta import read_teachers
from freerein.data.reader import Dataset
from freerein.data.timestep_texts import TextKind, TimestepTexts
from freerein.data.videos import are_stretched, stretch_notes
from freerein.errors import InvalidInput, NotFound, UnsupportedMedia, quoted
from freerein.types.common import Trajectory
from freerein.types.segmentation import NO_SKILL

_MOST_NAMED = 20


class LeRobotSource(Source):
    """The trajectories of a LeRobotDataset v3, of images or video; actions and the robot's state stay in their units.

    A camera that cannot be read in any of the first, a middle and the last trajectory is left out.

    Args:
        folder: Its folder.
        size: Height and width to scale frames to; None to keep their own.
        options: Which features are read, and whether damaged trajectories are left out.
        tags: CSV with the skills of trajectories, by their `episode_index`.
        tags_from: Takes the texts of these as skills.
        labels_from: Takes those of each timestep as true labels, which must be among the trajectory's skills.

    Raises:
        NotFound: There is no dataset.
        InvalidInput: It is not a supported LeRobotDataset v3, or corrupt; or it has no subtasks, or `tags` is no such
            table.
    """

    def __init__(
        self,
        folder: Path,
        *,
        size: tuple[int, int] | None = None,
        options: LeRobotOptions = DEFAULTS,
        tags: bytes | None = None,
        tags_from: TextKind | None = None,
        labels_from: TextKind | None = None,
    ) -> None:
        try:
            self._dataset = Dataset(folder, options)
        except NotFound:
            raise NotFound(
                f"There must be a LeRobotDataset v3 in the folder; {quoted(str(folder))} has no `meta/info.json`.",
                hint="Name the folder that holds `meta`; for the MIME dataset add --layout mime.",
            ) from None
        self._folder, self._size = folder, size
        self._options = options
        self._tag_texts = TimestepTexts(folder, self._dataset, tags_from) if tags_from else None
        self._label_texts = TimestepTexts(folder, self._dataset, labels_from) if labels_from else None
        self._damaged, self._changed = list[str](), list[str]()
        self._tags = tags
        own = self._dataset.spec
        cameras = {
            name: (*(size or (height, width)), channels)
            for name, (height, width, channels) in own.cameras.items()
            if name not in self._unreadable
        }
        skills = sorted({skill for each in self._skills for skill in each})
        self.spec = replace(own, cameras=cameras, skills=tuple(skills) or own.skills)

    @property
    def teachers(self) -> Sequence[Mapping[str, Any]]:
        """Cards of the policies that acted, where freerein wrote the dataset."""
        return read_teachers(self._folder)

    def __len__(self) -> int:
        return len(self._dataset)

    def __iter__(self) -> Iterator[Trajectory]:
        return (each.trajectory for each in self.recorded())

    def recorded(self) -> Iterator[Recorded]:
        """Yields each whole trajectory, with the robot's state and labels."""
        index = 0
        while index < len(self):
            try:
                items, cameras = range(index, len(self)), tuple(self.spec.cameras)
                for trajectory in self._dataset.stream(items, cameras=cameras, size=self._size):
                    recorded = Recorded(
                        replace(trajectory, skills=self._skills[index]),
                        robot_state=self._dataset.robot_state(index),
                        labels=self._labels(index, self._label_texts) if self._label_texts else None,
                        name=f"Trajectory {self._dataset.episodes[index]}",
                    )
                    index += 1
                    yield recorded
            except (InvalidInput, UnsupportedMedia) as error:
                index += 1
                if not self.skips(error):
                    raise

    def skips(self, error: InvalidInput | UnsupportedMedia) -> bool:
        """Returns whether damaged trajectories are left out, and notes one."""
        self._damaged.append(error.detail)
        return self._options.skip_damaged

    @property
    def notes(self) -> tuple[str, ...]:
        """Features that are left out and why, and cameras whose frames are stretched."""
        left_out = {**self._dataset.left_out, **self._unreadable}
        own = self._dataset.spec.cameras
        size = self._size
        stretched = {name: own[name][:2] for name in self.spec.cameras if size and are_stretched(own[name], size)}
        return (
            *(f"{quoted(name)} is left out: {why}." for name, why in left_out.items()),
            *self._numbering(),
            *self._tasks(),
            *self._changed,
            *stretch_notes(stretched, size),
            *self._losses(),
        )

    @cached_property
    def _unreadable(self) -> dict[str, str]:
        """Why frames of cameras cannot be read, by the camera; raises where none can."""
        count, asked = len(self), self._options.cameras
        items = sorted({0, count // 2, count - 1}) if count else []
        errors = {name: _unreadable(self._dataset, name, items) for name in self._dataset.spec.cameras}
        found = {name: error for name, error in errors.items() if error is not None}
        if found and (asked or len(found) == len(errors)):
            if self._options.skip_damaged:
                return {}
            raise next(iter(found.values()))
        return {name: error.detail.rstrip(".") for name, error in found.items()}

    @cached_property
    def _skills(self) -> list[tuple[str, ...]]:
        """The skills of each trajectory, sorted."""
        stored = self._dataset.skills
        if self._tag_texts is not None:
            texts = self._tag_texts
            stored = tuple(self._or_damaged(texts, index) for index in range(len(self)))
        found = [tuple(sorted(set(each))) for each in stored]
        if self._tags is None:
            return found
        names, known = list(map(str, self._dataset.episodes)), {skill for each in found for skill in each}
        given = read_tags(self._tags, names, known=known, on_note=self._changed.append)
        return [given.get(name, each) for name, each in zip(names, found, strict=True)]

    def _or_damaged(self, texts: TimestepTexts, index: int) -> tuple[str, ...]:
        try:
            return texts.occurring(index)
        except InvalidInput:
            if not self._options.skip_damaged:
                raise
            return ()  # the trajectory is left out when its actions are read

    def _labels(self, index: int, source: TimestepTexts) -> npt.NDArray[np.int64]:
        """Returns the true label of each timestep, int64 (T,)."""
        texts = source.of_timesteps(index)
        unknown = set(texts) - set(self._skills[index]) - {""}
        if unknown:
            raise InvalidInput(
                f"The labels of trajectory {self._dataset.episodes[index]} must be among its tags; {len(unknown)} are "
                f"not, such as {quoted(min(unknown))}.",
                hint="Take the tags from the same texts, with --tags-from.",
            )
        return np.array([self.spec.skills.index(text) if text else NO_SKILL for text in texts], np.int64)

    def _numbering(self) -> Iterator[str]:
        episodes = self._dataset.episodes
        if episodes != tuple(range(len(episodes))):
            first = next(index for index, episode in enumerate(episodes) if index != episode)
            yield (
                f"Episodes are numbered anew, because some are missing: episode {episodes[first]} is now trajectory "
                f"{first}."
            )

    def _tasks(self) -> Iterator[str]:
        several = sum(len(set(each)) > 1 for each in self._dataset.tasks)
        if several and not any(self._skills):
            yield f"{several} episodes have several tasks: --tags-from task takes them as tags."

    def _losses(self) -> Iterator[str]:
        if self._damaged:
            yield f"{len(self._damaged)} of {len(self)} trajectories are damaged and left out:"
            yield from self._damaged[:_MOST_NAMED]


def _unreadable(dataset: Dataset, camera: str, items: Sequence[int]) -> InvalidInput | UnsupportedMedia | None:
    """Returns why the first frame of a camera can be read in none of the trajectories; None where it can in one."""
    errors = list[InvalidInput | UnsupportedMedia]()
    for index in items:
        try:
            for _ in dataset.first_frames([index], camera):
                return None
        except (InvalidInput, UnsupportedMedia) as error:
            errors.append(error)
    return errors[0] if errors else None
