"""Trajectories as people keep them: a folder of images, or a video, for each; `freerein.data.recordings` says how.

Without any `actions.csv` trajectories have no actions.
"""

from collections.abc import Iterable, Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from statistics import median

import numpy as np
import numpy.typing as npt

from freerein import images
from freerein.data.action_table import read_actions
from freerein.data.annotations import read_tags
from freerein.data.image_names import natural, times_s
from freerein.data.importing import Recorded, Source
from freerein.data.layout import DatasetSpec
from freerein.data.recordings import (
    ACTIONS,
    CAMERA,
    TAGS,
    Files,
    Recording,
    find_recordings,
    is_image,
    is_of_system,
    system_files,
    table_in,
)
from freerein.data.videos import BOUNDS, are_stretched, joined, stretch_notes
from freerein.errors import InvalidInput, NotFound, quoted
from freerein.regular_files import read_regular
from freerein.types.common import ActionSpec, Image, Trajectory
from freerein.video import frames_at_rate, open_video

_RUNS = 50
_MOST_OFF_RATE = 0.1
_SHORTER, _LONGEST = 128, 1024
"""Shorter side that images are scaled to, and most of the longer one."""

Pixels = npt.NDArray[np.uint8]


class FolderSource(Source):
    """Trajectories in folders of images, or in videos.

    Args:
        folder: Holds them; see `freerein.data.recordings`.
        size: Height and width to scale frames to; None to keep their own, which must then be one.
        fps: Timesteps per second: of images, and of what a video shows, whatever its own rate.
        tags: CSV with the skills of trajectories by name, instead of `tags.csv`.

    Raises:
        NotFound: The folder holds no trajectory.
        InvalidInput: As `find_recordings`, or some trajectories lack actions; a table names no trajectory; an action is
            no number; a file is no regular one.
    """

    def __init__(
        self, folder: Path, *, size: tuple[int, int] | None = None, fps: int = 10, tags: bytes | None = None
    ) -> None:
        self._recordings = find_recordings(folder)
        self._ignored = system_files(folder)
        self._size = size
        self._stretched: dict[str, tuple[int, ...]] = {}
        self.names = tuple(each.name for each in self._recordings)
        """Names of the trajectories, in their order."""
        if tags is None and (table := table_in(folder, TAGS)) is not None:
            tags = read_regular(table, name=TAGS)
        self._spellings = list[str]()
        self._skills = read_tags(tags, self.names, on_note=self._spellings.append) if tags is not None else {}
        self._actions = [_actions(each) for each in self._recordings]
        for each in self._recordings:
            _check_rate(each, fps)
        kinds = {(names, values.shape[1]) for names, values in self._actions}
        if len(kinds) > 1:
            raise InvalidInput(
                f"All trajectories must have the same columns in `{ACTIONS}`, or none; they have {len(kinds)} kinds.",
                hint="Give each trajectory its actions, or none.",
            )
        ((names, action_size),) = kinds
        self.spec = DatasetSpec(
            fps=fps,
            cameras={camera: _shape(files, size) for camera, files in self._recordings[0].cameras.items()},
            action=ActionSpec(size=action_size, choices=0, names=names),
            robot_type="",
            skills=tuple(sorted({skill for skills in self._skills.values() for skill in skills})),
            has_scaled_actions=False,
        )

    @property
    def contents(self) -> str:
        """Names of trajectories and cameras, actions, how many have tags, and the rate."""
        first, *others = self.names
        named = sorted(set(self.spec.cameras) - {CAMERA})
        cameras = f"cameras {', '.join(self.spec.cameras)}" if named else "one camera"
        tagged = f"{len(self._skills)} with tags" if self._skills else "no tags"
        size = self.spec.action.size
        actions = f"actions of {size} numbers" if size else "no actions"
        names = f"{first} to {others[-1]}" if others else first
        return f"{names}, {cameras}, {actions}, {tagged}, {self.spec.fps} timesteps a second"

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes: what was stretched, spelled otherwise in tags, or ignored because operating systems left it."""
        named = ", ".join(f"{name} ({count})" for name, count in sorted(self._ignored.items()))
        ignored = (f"Ignored what operating systems left: {named}.",) if named else ()
        return (*stretch_notes(self._stretched, self._size), *self._spellings, *ignored)

    def __len__(self) -> int:
        return len(self._recordings)

    def recorded(self) -> Iterator[Recorded]:
        """Yields each by its name."""
        return (Recorded(each, name=f"`{name}`") for name, each in zip(self.names, self, strict=True))

    def __iter__(self) -> Iterator[Trajectory]:
        for recording, (_, values) in zip(self._recordings, self._actions, strict=True):
            frames = {camera: self._frames(recording, camera) for camera in recording.cameras}
            length = _common_length(recording, frames)
            actions = values if self.spec.has_actions else np.empty((length, 0), np.float32)
            if len(actions) != length:
                raise InvalidInput(
                    f"`{recording.name}/{ACTIONS}` must have a line for each of {length} images; "
                    f"it has {len(actions)}.",
                    hint="The action of an image is executed after it; repeat the last one for the last image.",
                )
            cut = {camera: each[:length] for camera, each in frames.items()}
            yield Trajectory(cut, actions, self._skills.get(recording.name, ()))

    def _frames(self, recording: Recording, camera: str) -> Pixels:
        """Returns the frames of a camera, uint8 (T, H, W, C)."""
        files, shape = recording.cameras[camera], self.spec.cameras[camera]
        if not isinstance(files, Path):
            return joined(self._images(recording, camera, files), shape)
        with open_video(files, channels=shape[2], size=self._size, bounds=BOUNDS, field=files.name) as video:
            own = (video.info.height, video.info.width)
            self._note_size(recording, camera, own)
            if self._size is None and own != shape[:2]:
                raise InvalidInput(
                    f"All videos of a camera must be {shape[0]} x {shape[1]}, as the first; "
                    f"`{files.parent.name}/{files.name}` is {own[0]} x {own[1]}.",
                    hint="Scale them, --size HxW; turn or crop those of other proportions first.",
                )
            sampled = frames_at_rate(video, fps=self.spec.fps, file=files.name)
            return joined((frame.pixels for frame in sampled), shape)

    def _images(self, recording: Recording, camera: str, files: Iterable[Path]) -> Iterator[Pixels]:
        for file in files:
            pixels = _decoded(file)
            self._note_size(recording, camera, pixels.shape)
            yield _in_shape(pixels, self._size, self.spec.cameras[camera], file)

    def _note_size(self, recording: Recording, camera: str, own: tuple[int, ...]) -> None:
        if self._size is not None and are_stretched(own, self._size):
            self._stretched.setdefault(f"{recording.name}/{camera}", own[:2])


class ImageSource(Source):
    """Unlabelled images of a folder, and of the folders in it, as trajectories without actions or tags.

    A run of images in the order of their names is a trajectory, about 50 in all, so that held-out images are others.

    Args:
        folder: Holds PNG, JPEG or WebP files.
        size: Height and width to scale images to; None for those of the first image, with a shorter side of 128: how
            things lie to one another can be seen in its proportions.

    Raises:
        NotFound: There are fewer than two images.
    """

    def __init__(self, folder: Path, *, size: tuple[int, int] | None = None) -> None:
        by_folder: dict[Path, list[Path]] = {}
        for file in sorted(folder.rglob("*"), key=natural) if folder.is_dir() else ():
            parts = file.relative_to(folder).parts
            if is_image(file) and not any(part[0] == "." or is_of_system(part) for part in parts):
                by_folder.setdefault(file.parent, []).append(file)
        count = sum(map(len, by_folder.values()))
        if count < 2:
            raise NotFound(
                f"The folder must hold PNG, JPEG or WebP files, at least 2; it holds {count}.",
                field="images",
                hint="Name the folder of the images, or one that holds such folders.",
            )
        run = max(1, count // _RUNS)
        self._runs = [files[at : at + run] for files in by_folder.values() for at in range(0, len(files), run)]
        if len(self._runs) == 1:
            self._runs = [self._runs[0][:1], self._runs[0][1:]]
        self._stretched: dict[str, tuple[int, ...]] = {}
        height, width, _ = _decoded(self._runs[0][0]).shape
        scale = _SHORTER / min(height, width)
        shape = (*(size or (min(_LONGEST, round(height * scale)), min(_LONGEST, round(width * scale)))), 3)
        self._shape = shape
        self.spec = DatasetSpec(1, {CAMERA: shape}, ActionSpec(0, 0, ()), robot_type="")

    def __len__(self) -> int:
        return len(self._runs)

    def __iter__(self) -> Iterator[Trajectory]:
        for files in self._runs:
            frames = joined(map(self._scaled, files), self._shape)
            yield Trajectory({CAMERA: frames}, np.empty((len(files), 0), np.float32))

    @property
    def notes(self) -> tuple[str, ...]:
        """Which images were stretched."""
        return stretch_notes(self._stretched, self._shape[:2])

    def _scaled(self, file: Path) -> Pixels:
        pixels, size = _decoded(file), self._shape[:2]
        if are_stretched(pixels.shape, size):
            self._stretched[f"{file.parent.name}/{file.name}"] = pixels.shape[:2]
        return _in_shape(pixels, size, self._shape, file)


def _check_rate(recording: Recording, fps: int) -> None:
    """Raises InvalidInput where the times that images are named by tell another rate."""
    for files in recording.cameras.values():
        times = times_s(files) if isinstance(files, tuple) else ()
        step_s = float(median(after - before for before, after in pairwise(times))) if times[1:] else 0.0
        if step_s > 0 and abs(step_s * fps - 1) > _MOST_OFF_RATE:
            raise InvalidInput(
                f"Images must be {fps} a second, by --fps; those of {quoted(recording.name)} are {1 / step_s:.4g}, as "
                f"their names say.",
                field="fps",
                hint=f"freerein dataset import FOLDER NAME --fps {max(1, round(1 / step_s))}",
            )


def _actions(recording: Recording) -> tuple[tuple[str, ...], npt.NDArray[np.float32]]:
    """Returns the names of an action's numbers, if any, and the actions, float32 (T, A); A is 0 without actions."""
    if recording.actions is None:
        return (), np.empty((0, 0), np.float32)
    name = f"{recording.name}/{ACTIONS}"
    names, values = read_actions(read_regular(recording.actions, name=name), file=name)
    return names, values.astype(np.float32)


def _shape(files: Files, size: tuple[int, int] | None) -> tuple[int, int, int]:
    """Returns (H, W, C) of a camera's frames."""
    if isinstance(files, Path):
        with open_video(files, bounds=BOUNDS, field=files.name) as video:
            return (*(size or (video.info.height, video.info.width)), 3)
    height, width, channels = _decoded(files[0]).shape
    return (*(size or (height, width)), channels)


def _in_shape(pixels: Pixels, size: tuple[int, int] | None, shape: tuple[int, int, int], file: Path) -> Pixels:
    """Returns an image of a file scaled, uint8 (H, W, C); gray ones become RGB where the first is."""
    if size is not None and pixels.shape[:2] != size:
        pixels = images.resize(pixels[None], size)[0]
    if pixels.shape[:2] != shape[:2] or pixels.shape[2] > shape[2]:
        raise InvalidInput(
            f"All images of a camera must be {shape[0]} x {shape[1]} with {shape[2]} channels, as the first; "
            f"`{file.parent.name}/{file.name}` is {' x '.join(map(str, pixels.shape))}.",
            hint="Scale them, --size HxW, and save all in colour, or all in gray.",
        )
    return np.ascontiguousarray(np.broadcast_to(pixels, shape))


def _decoded(file: Path) -> Pixels:
    name = f"{file.parent.name}/{file.name}"
    data = read_regular(file, name=name)
    return images.decode(Image(images.sniff(data, field=name), 0, 0, data), field=name)


def _common_length(recording: Recording, frames: Mapping[str, Pixels]) -> int:
    """Returns the timesteps of a trajectory; videos may end a frame apart."""
    lengths = sorted(map(len, frames.values()))
    slack = 1 if any(isinstance(files, Path) for files in recording.cameras.values()) else 0
    if lengths[-1] - lengths[0] > slack:
        raise InvalidInput(
            f"All cameras of a trajectory must have as many images; those of `{recording.name}` have {lengths[0]} to "
            f"{lengths[-1]}.",
            hint="Leave out what one camera did not see. Where these are trajectories, name their folder: "
            f"`{recording.name}`.",
        )
    return lengths[0]
