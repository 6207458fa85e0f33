"""`Dataset`, what learners read. Ground truth cannot be reached: no module imported here knows where it lies."""

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import cast

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from freerein import images
from freerein.data import layout, lerobot, meta, tags
from freerein.data.cache import StepCache, open_or_build
from freerein.data.trajectory_file import (
    Actions,
    State,
    decode_actions,
    decode_frames,
    decode_state,
    decode_terminations,
    read_rows,
)
from freerein.data.videos import VideoSpan, video_frames
from freerein.errors import InvalidInput
from freerein.types.common import Trajectory


class Dataset:
    """Read-only sequence of the trajectories that a dataset held when it was opened.

    Opening compares `meta/` with `data/` and rewrites it where a crash left it out of date. Also opens any
    LeRobotDataset v3 of images or video. Where that has no `next.terminated`, `terminated` is
    its `next.done`, which most tools also set where an episode was truncated.

    Attributes:
        spec: Properties that the trajectories share.
        lengths: int64 (n,), timesteps of each trajectory.
        skills: Skills that occur in each trajectory, sorted; empty where unknown.
        goal_texts: Goal text of each trajectory, the spec's `task` by default; empty where unknown.

    Raises:
        NotFound: There is no dataset in `root`.
        InvalidInput: A file is missing or corrupt, or the features are not supported.
    """

    def __init__(self, root: Path) -> None:
        self._root = root
        spec, given = meta.read_spec(root), tags.read(root)
        if spec is None:
            foreign = lerobot.read(root)
            self.spec, table, self._keys = foreign.spec, foreign.episodes, foreign.camera_keys
            self._videos = foreign.videos
            if given:
                self.spec, table = replace(foreign.spec, skills=given.skills), meta.with_tags(table, given)
            self._terminated_key = foreign.terminated_key
        else:
            self.spec, table = spec, meta.load_and_repair(root, spec)
            self._keys = {camera: layout.camera_key(camera) for camera in spec.cameras}
            self._videos = dict[str, tuple[VideoSpan, ...]]()
            self._terminated_key = layout.TERMINATED_KEY if spec.has_terminations else ""
        self.lengths: npt.NDArray[np.int64] = table["length"].to_numpy().astype(np.int64)
        self.skills = tuple(tuple(skills) for skills in table["skills"].to_pylist())
        self.goal_texts = tuple(texts[0] if len(texts) == 1 else self.spec.task for texts in table["tasks"].to_pylist())
        chunks, files = table["data/chunk_index"].to_pylist(), table["data/file_index"].to_pylist()
        self._places = list(zip(chunks, files, strict=True))
        self._hashes = table["data/sha256"].to_pylist() if "data/sha256" in table.column_names else None
        self._tags_sha256 = given.sha256 if given else ""

    def __len__(self) -> int:
        return len(self.lengths)

    def __getitem__(self, index: int) -> Trajectory:
        """Returns one decoded trajectory; a negative index counts from the end.

        Raises:
            IndexError: There is no such trajectory.
            InvalidInput: Its file is corrupt, or does not match the spec.
        """
        return next(self.stream([range(len(self))[index]]))

    def __iter__(self) -> Iterator[Trajectory]:
        return self.stream(range(len(self)))

    def stream(
        self, items: Sequence[int], *, cameras: Sequence[str] = (), size: tuple[int, int] | None = None
    ) -> Iterator[Trajectory]:
        """Yields decoded trajectories; files of several are decoded once where `items` ascend.

        Args:
            items: Their indices.
            cameras: Cameras of the frames; empty for all.
            size: Height and width to scale frames to; None to keep their own.

        Raises:
            InvalidInput: A file is corrupt, or does not match the spec.
        """
        chosen = cameras or tuple(self.spec.cameras)
        frames = {camera: self._frames(items, camera, size=size) for camera in chosen}
        for index in items:
            terminated = [self._terminated_key] if self.spec.has_terminations else []
            rows = self._rows(index, [*self._action_columns, *terminated])
            yield Trajectory(
                frames={camera: next(each) for camera, each in frames.items()},
                actions=decode_actions(rows, self.spec),
                skills=self.skills[index],
                goal_text=self.goal_texts[index],
                terminated=self._terminations(rows) if self.spec.has_terminations else None,
            )

    def actions(self, index: int) -> Actions:
        """Returns the actions of one trajectory, float32 (T, A) or int64 (T, 1), without decoding its frames."""
        return decode_actions(self._rows(range(len(self))[index], self._action_columns), self.spec)

    def robot_state(self, index: int) -> State | None:
        """Returns the robot's own state in one trajectory, float32 (T, S) in its own units; None where it is not kept.

        A `Trajectory` does not have it, nor what fits learn from, but for those of `skill_cloning` that ask for it.
        """
        if not self.spec.robot_state_size:
            return None
        return decode_state(self._rows(range(len(self))[index], [layout.STATE_KEY]), self.spec)

    def first_frames(self, items: Sequence[int], camera: str) -> Iterator[npt.NDArray[np.uint8]]:
        """Yields the first frame of some trajectories, uint8 (H, W, C); raises as `stream`."""
        return (frames[0] for frames in self._frames(items, camera, most=1))

    @property
    def fingerprint(self) -> str:
        """The sha256, in hexadecimal, over the sha256 of every data file, and of tags that were given later.

        Reads no data file of a dataset that freerein wrote: the writer recorded the hashes, and `verify` checks them.
        """
        if not self._tags_sha256:
            return self._data_sha256
        return hashlib.sha256(f"{self._data_sha256}\n{self._tags_sha256}".encode()).hexdigest()

    @cached_property
    def _data_sha256(self) -> str:
        videos = (span.root / span.file for spans in self._videos.values() for span in spans)
        files = dict.fromkeys([*map(self._path, self._places), *videos])
        hashes = self._hashes or [_sha256(path) for path in files]
        return hashlib.sha256("\n".join(hashes).encode()).hexdigest()

    def cached_frames(self, camera: str) -> StepCache[np.uint8]:
        """Returns one camera's frames of all trajectories, decoded once and mapped into memory.

        Raises:
            InvalidInput: The dataset is empty or has no such camera; or as `dataset[i]`.
            FailedPrecondition: The disk is too small for the decoded frames.
        """
        if camera not in self.spec.cameras:
            raise InvalidInput(
                f"`camera` must be one of {', '.join(self.spec.cameras)}; got another name.",
                field="camera",
                hint="Choose a camera that the dataset has.",
            )
        parts = self._frames(range(len(self)), camera)
        path, shape = self._cache_file(f"frames-{camera}"), self.spec.cameras[camera]
        return open_or_build(path, dtype=np.dtype(np.uint8), shape=shape, lengths=self.lengths, parts=parts)

    def cached_actions(self) -> StepCache[np.float32] | StepCache[np.int64]:
        """Returns the actions of all trajectories, read once and mapped into memory.

        Raises:
            InvalidInput: The dataset is empty; or as `dataset[i]`.
            OutOfStorage: The disk is full.
        """
        if not self.spec.has_actions:
            return StepCache(np.empty((self.lengths.sum(), 0), np.float32), np.append(0, self.lengths.cumsum()))
        parts = (self.actions(index) for index in range(len(self)))
        shape, dtype = (self.spec.action.size,), self.spec.action.dtype
        cache = open_or_build(self._cache_file("actions"), dtype=dtype, shape=shape, lengths=self.lengths, parts=parts)
        return cast(StepCache[np.float32] | StepCache[np.int64], cache)

    def cached_terminations(self) -> StepCache[np.bool_] | None:
        """Returns `terminated` of all trajectories, read once and mapped into memory; None where it is unknown.

        Raises:
            InvalidInput: The dataset is empty; or as `dataset[i]`.
            OutOfStorage: The disk is full.
        """
        if not self.spec.has_terminations:
            return None
        parts = (self._terminations(self._rows(index, [self._terminated_key])) for index in range(len(self)))
        path = self._cache_file("terminations")
        return open_or_build(path, dtype=np.dtype(np.bool_), shape=(), lengths=self.lengths, parts=parts)

    @property
    def _action_columns(self) -> list[str]:
        return ["action"] if self.spec.has_actions else []

    def _rows(self, index: int, columns: list[str]) -> pa.Table:
        rows = read_rows(self._path(self._places[index]), index=index, columns=columns)
        if len(rows) != self.lengths[index]:
            raise InvalidInput(
                f"Trajectory {index} must have the {self.lengths[index]} timesteps that `meta/` names; "
                f"its data file holds {len(rows)}.",
                hint="Run `freerein dataset verify`, and restore the broken file from a copy.",
            )
        return rows

    def _frames(
        self, items: Sequence[int], camera: str, *, size: tuple[int, int] | None = None, most: int | None = None
    ) -> Iterator[npt.NDArray[np.uint8]]:
        """Yields the frames of one camera, uint8 (T, H, W, C), at most the first `most` of each trajectory."""
        height, width, channels = self.spec.cameras[camera]
        if camera in self._videos:
            spans = [self._videos[camera][index] for index in items]
            cut = [replace(span, length=min(span.length, most or span.length)) for span in spans]
            yield from video_frames(cut, fps=self.spec.fps, size=(*(size or (height, width)), channels))
            return
        key = self._keys[camera]
        for index in items:
            rows = self._rows(index, [key]).slice(0, most)
            frames = decode_frames(rows, camera_key=key, size=(height, width, channels))
            yield images.resize(frames, size) if size else frames

    def _terminations(self, rows: pa.Table) -> npt.NDArray[np.bool_]:
        return decode_terminations(rows, key=self._terminated_key)

    def _path(self, place: tuple[int, int]) -> Path:
        return layout.numbered(self._root / "data", chunk=place[0], file=place[1])

    def _cache_file(self, name: str) -> Path:
        return self._root / "cache" / self._data_sha256[:16] / f"{name}.raw"


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
