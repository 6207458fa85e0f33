"""`Dataset`, what learners read. Ground truth cannot be reached: no module imported here knows where it lies."""

import hashlib
import json
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import cast

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from freerein import images
from freerein.data import layout, lerobot, meta, tags
from freerein.data.cache import D, StepCache, open_or_build
from freerein.data.episode_files import EpisodeFiles
from freerein.data.layout import DatasetSpec
from freerein.data.lerobot import LeRobotMeta
from freerein.data.lerobot_features import DEFAULTS, LeRobotOptions
from freerein.data.trajectory_file import (
    Actions,
    State,
    corrupt_as_invalid,
    decode_actions,
    decode_frames,
    decode_state,
    decode_terminations,
)
from freerein.data.videos import video_frames
from freerein.errors import InvalidInput, UnsupportedMedia, must_be, quoted
from freerein.regular_files import open_regular
from freerein.types.common import Trajectory

_WHOLE = slice(None)


class Dataset:
    """Read-only sequence of the trajectories that a dataset held when it was opened.

    Opening compares `meta/` with `data/` and rewrites it where a crash left it out of date. Also opens any
    LeRobotDataset v3 of images or video. Where that has no `next.terminated`, `terminated` is
    its `next.done`, which most tools also set where an episode was truncated.

    Args:
        root: The dataset's folder.
        options: What is read of another tool's dataset; `cached_...` needs the defaults.

    Attributes:
        spec: Properties that the trajectories share.
        episodes: LeRobot's `episode_index` of each trajectory: its index, but in datasets of other tools with gaps.
        left_out: Why each feature of another tool's dataset is not read that is not, by its name.
        lengths: int64 (n,), timesteps of each trajectory.
        skills: Skills that occur in each trajectory, sorted; empty where unknown.
        tasks: LeRobot's tasks of each trajectory; its goal text where there is one.
        goal_texts: Goal text of each trajectory, the spec's `task` by default; empty where unknown.

    Raises:
        NotFound: There is no dataset in `root`.
        InvalidInput: A file is missing or corrupt, or the features are not supported.
    """

    def __init__(self, root: Path, options: LeRobotOptions = DEFAULTS) -> None:
        self._root = root
        spec, given = meta.read_spec(root), tags.read(root)
        if spec is not None and options != DEFAULTS:
            raise InvalidInput(
                "Features must be chosen of another program's dataset; freerein wrote this one, and reads all of it.",
                hint="Leave out --action, --state, --cameras and --skip-damaged.",
            )
        self._meta = lerobot.read(root, options) if spec is None else _own(root, spec)
        self.spec, table, self.left_out = self._meta.spec, self._meta.episodes, self._meta.left_out
        if spec is None and given:
            self.spec, table = replace(self.spec, skills=given.skills), meta.with_tags(table, given)
        self.episodes: tuple[int, ...] = tuple(table["episode_index"].to_pylist())
        self.lengths: npt.NDArray[np.int64] = table["length"].to_numpy().astype(np.int64)
        self.skills = tuple(tuple(skills) for skills in table["skills"].to_pylist())
        self.tasks = tuple(tuple(texts) for texts in table["tasks"].to_pylist())
        self.goal_texts = tuple(texts[0] if len(texts) == 1 else self.spec.task for texts in self.tasks)
        chunks, files = table["data/chunk_index"].to_pylist(), table["data/file_index"].to_pylist()
        places = zip(self.episodes, chunks, files, strict=True)
        named = {each: layout.numbered(root / "data", chunk=chunk, file=file) for each, chunk, file in places}
        self._files = EpisodeFiles(root, named, is_searched=spec is None)
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
            actions, terminated = self._actions_and_terminations(index)
            yield Trajectory(
                frames={camera: next(each) for camera, each in frames.items()},
                actions=actions,
                skills=self.skills[index],
                goal_text=self.goal_texts[index],
                terminated=terminated,
            )

    def actions(self, index: int) -> Actions:
        """Returns the actions of one trajectory, float32 (T, A) or int64 (T, 1), without decoding its frames."""
        index = range(len(self))[index]
        with self._named(index):
            return decode_actions(self._rows(index, [*self._meta.action_columns]), self.spec, self._meta.action_columns)

    def robot_state(self, index: int) -> State | None:
        """Returns the robot's own state in one trajectory, float32 (T, S) in its own units; None where it is not kept.

        A `Trajectory` does not have it, nor what fits learn from, but for those of `skill_cloning` that ask for it.
        """
        if not self.spec.robot_state_size:
            return None
        index = range(len(self))[index]
        with self._named(index):
            return decode_state(self._rows(index, [*self._meta.state_columns]), self._meta.state_columns)

    def stored_columns(self, index: int, names: Sequence[str]) -> pa.Table:
        """Returns columns of a trajectory's data file as they are stored; raises InvalidInput where one is missing."""
        with self._named(index):
            return self._rows(index, names)

    def first_frames(self, items: Sequence[int], camera: str) -> Iterator[npt.NDArray[np.uint8]]:
        """Yields the first frame of some trajectories, uint8 (H, W, C); raises as `stream`."""
        return (frames[0] for frames in self._frames(items, camera, part=slice(1)))

    def frames(
        self, index: int, camera: str, part: slice, *, size: tuple[int, int] | None = None
    ) -> npt.NDArray[np.uint8]:
        """Returns some frames of one trajectory, uint8 (n, H, W, C), without decoding others; raises as `stream`.

        Of a video, those before them are decoded, too. `size` is the height and width to scale them to.
        """
        return next(self._frames([range(len(self))[index]], camera, size=size, part=part))

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
        if self._hashes is not None:
            return hashlib.sha256("\n".join(self._hashes).encode()).hexdigest()
        spans = [span for spans in self._meta.videos.values() for span in spans]
        files = dict.fromkeys([*self._files.paths, *(span.root / span.file for span in spans)])
        listed = [self.episodes, self.lengths.tolist(), [span.start_s for span in spans]]
        hashes = [*(_sha256(path) for path in files), json.dumps(listed)]
        return hashlib.sha256("\n".join(hashes).encode()).hexdigest()

    def cached_frames(self, camera: str) -> StepCache[np.uint8]:
        """Returns one camera's frames of all trajectories, decoded once and mapped into memory.

        Raises:
            InvalidInput: The dataset is empty or has no such camera; or as `dataset[i]`.
            OutOfStorage: The disk is full, or too small for the decoded frames.
        """
        if camera not in self.spec.cameras:
            rule, hint = f"one of {', '.join(self.spec.cameras)}", "Choose a camera that the dataset has."
            raise must_be("camera", rule, quoted(camera), hint=hint)
        parts, shape = self._frames(range(len(self)), camera), self.spec.cameras[camera]
        return self._cached(f"frames-{camera}", parts, np.dtype(np.uint8), shape)

    def cached_actions(self) -> StepCache[np.float32] | StepCache[np.int64]:
        """Returns the actions of all trajectories, read once and mapped into memory.

        Raises:
            InvalidInput: The dataset is empty; or as `dataset[i]`.
            OutOfStorage: The disk is full.
        """
        if not self.spec.has_actions:
            return StepCache(np.empty((self.lengths.sum(), 0), np.float32), np.append(0, self.lengths.cumsum()))
        parts = (self.actions(index) for index in range(len(self)))
        cache = self._cached("actions", parts, self.spec.action.dtype, (self.spec.action.size,))
        return cast(StepCache[np.float32] | StepCache[np.int64], cache)

    def cached_terminations(self) -> StepCache[np.bool_] | None:
        """Returns whether the episode ended after each timestep of all trajectories; None where that is not known.

        Raises as `cached_actions`.
        """
        key = self._meta.terminated_key
        if not key:
            return None
        parts = (self._terminations(index, key) for index in range(len(self)))
        return self._cached("terminations", parts, np.dtype(np.bool_), ())

    def _terminations(self, index: int, key: str) -> npt.NDArray[np.bool_]:
        with self._named(index):
            return decode_terminations(self._rows(index, [key]), key=key)

    def _actions_and_terminations(self, index: int) -> tuple[Actions, npt.NDArray[np.bool_] | None]:
        columns, key = self._meta.action_columns, self._meta.terminated_key
        with self._named(index):
            rows = self._rows(index, [*columns, key] if key else [*columns])
            actions = decode_actions(rows, self.spec, columns)
            return actions, decode_terminations(rows, key=key) if key else None

    def _rows(self, index: int, columns: Sequence[str]) -> pa.Table:
        return self._files.rows(self.episodes[index], columns, length=int(self.lengths[index]))

    def _frames(
        self, items: Sequence[int], camera: str, *, size: tuple[int, int] | None = None, part: slice = _WHOLE
    ) -> Iterator[npt.NDArray[np.uint8]]:
        """Yields the frames of one camera, uint8 (T, H, W, C), or a part of them, of each trajectory."""
        read = self._video_frames if camera in self._meta.videos else self._image_frames
        frames = read(items, camera, size=size, part=part)
        for index in items:
            with self._named(index, camera):
                found = next(frames)
            yield found

    def _video_frames(
        self, items: Sequence[int], camera: str, *, size: tuple[int, int] | None, part: slice
    ) -> Iterator[npt.NDArray[np.uint8]]:
        height, width, channels = self.spec.cameras[camera]
        spans = [self._meta.videos[camera][index] for index in items]
        cut = [span.part(range(span.length)[part], self.spec.fps) for span in spans]
        scaled = (*(size or (height, width)), channels)
        return video_frames(cut, fps=self.spec.fps, size=scaled, declared=(height, width))

    def _image_frames(
        self, items: Sequence[int], camera: str, *, size: tuple[int, int] | None, part: slice
    ) -> Iterator[npt.NDArray[np.uint8]]:
        key = self._meta.camera_keys[camera]
        for index in items:
            length = int(self.lengths[index])
            if part == _WHOLE:
                rows = self._rows(index, [key])
            else:
                rows = self._files.part(self.episodes[index], key, timesteps=range(length)[part], length=length)
            frames = decode_frames(rows, camera_key=key, size=self.spec.cameras[camera])
            yield images.resize(frames, size) if size else frames

    @contextmanager
    def _named(self, index: int, camera: str = "") -> Iterator[None]:
        """Names a trajectory, and its file or camera, in the errors of the body."""
        try:
            yield
        except (InvalidInput, UnsupportedMedia) as error:
            place = f"camera `{camera}`" if camera in self._meta.videos else self._files.name(self.episodes[index])
            detail = f"Trajectory {self.episodes[index]}, {place}: {error.detail}"
            raise type(error)(detail, field=error.field, hint=error.hint) from None
        except MemoryError:
            raise InvalidInput(
                f"The {self.lengths[index]} frames of trajectory {self.episodes[index]} must fit into memory; they do "
                "not.",
                hint="Import the dataset with smaller ones, --size 96x128, or cut the trajectory.",
            ) from None

    def _cached(
        self, name: str, parts: Iterable[npt.NDArray[D]], dtype: np.dtype[D], shape: tuple[int, ...]
    ) -> StepCache[D]:
        path = self._root / "cache" / self._data_sha256[:16] / f"{name}.raw"
        return open_or_build(path, dtype=dtype, shape=shape, lengths=self.lengths, parts=parts)


def _own(root: Path, spec: DatasetSpec) -> LeRobotMeta:
    """Returns the metadata of a dataset that freerein wrote."""
    return LeRobotMeta(
        spec,
        meta.load_and_repair(root, spec),
        camera_keys={camera: layout.camera_key(camera) for camera in spec.cameras},
        action_columns={"action": spec.action.size} if spec.has_actions else {},
        state_columns={layout.STATE_KEY: spec.robot_state_size},
        terminated_key=layout.TERMINATED_KEY if spec.has_terminations else "",
    )


def _sha256(path: Path) -> str:
    with corrupt_as_invalid(f"`{path.name}`"), open_regular(path, name=path.name) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
