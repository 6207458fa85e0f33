"""Trajectories as people keep them: a folder of images, or a video, for each.

    <folder>/<trajectory>/0.png, 1.png, ...            images of one camera, in the order of their numbers or times
             <trajectory>/<camera>/0.png, ...          or of several
             <trajectory>/<camera>.mp4                 or videos
             <trajectory>.mp4                          or one video alone (mp4 or mov)
             <trajectory>/actions.csv                  the action of each image in a line, below a line of names or not
             tags.csv                                  lines such as `<trajectory>,reach;pour` below `trajectory,skills`

Trajectories are in the order of their names, numbers in them by value. Without any `actions.csv` they have no actions.
"""

import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

import numpy as np
import numpy.typing as npt

from freerein import images
from freerein.data.action_table import read_actions
from freerein.data.annotations import read_tags
from freerein.data.importing import Source
from freerein.data.layout import DatasetSpec
from freerein.data.videos import BOUNDS, frames_at_rate, joined
from freerein.errors import InvalidInput, NotFound
from freerein.types.common import ActionSpec, Image, Trajectory
from freerein.video import open_video

CAMERA = "camera"
"""Name of the camera of images or of a video that name none."""

ACTIONS, TAGS = "actions.csv", "tags.csv"
_IMAGES, _VIDEOS = frozenset((".png", ".jpg", ".jpeg", ".webp")), frozenset((".mp4", ".m4v", ".mov"))
_NOTES = frozenset((".csv", ".json", ".md", ".txt"))
"""Of files beside images and videos that may be there and are not read, but for the tables."""

_RUNS = 50
_SHORTER, _LONGEST = 128, 1024
"""Shorter side that images are scaled to, and most of the longer one."""

_WHOLE, _DECIMAL = re.compile(r"\d+|\D+"), re.compile(r"\d+(?:\.\d+)?|\D+")
"""Numbers in names, and what is between them."""

_TIME = re.compile(r"\d{9,}")
"""Time since the epoch in a name, in seconds: a dot after it does not separate two numbers."""

Pixels = npt.NDArray[np.uint8]
Files = Path | tuple[Path, ...]
"""A video, or images in order."""


@dataclass(frozen=True)
class _Recording:
    """The files of a trajectory: by camera, and of its actions, if any."""

    name: str
    cameras: Mapping[str, Files]
    actions: Path | None = None


class FolderSource(Source):
    """Trajectories in folders of images, or in videos.

    Args:
        folder: Holds them, as above.
        size: Height and width to scale frames to; None to keep their own, which must then be one.
        fps: Timesteps per second: of images, and of what a video shows, whatever its own rate.
        tags: CSV with the skills of trajectories by name, instead of `tags.csv`.

    Raises:
        NotFound: The folder holds no trajectory.
        InvalidInput: Trajectories differ in their cameras, or some lack actions; a file might be a recording and cannot
            be read; two have one name; a table names no trajectory; an action is no number.
    """

    def __init__(
        self, folder: Path, *, size: tuple[int, int] | None = None, fps: int = 10, tags: bytes | None = None
    ) -> None:
        self._recordings = _recordings(folder)
        self._size = size
        self.names = tuple(each.name for each in self._recordings)
        """Names of the trajectories, in their order."""
        if tags is None and (folder / TAGS).is_file():
            tags = (folder / TAGS).read_bytes()
        self._skills = read_tags(tags, self.names) if tags is not None else {}
        self._actions = [_actions(each) for each in self._recordings]
        kinds = {(names, values.shape[1]) for names, values in self._actions}
        if len(kinds) > 1:
            raise InvalidInput(
                f"All trajectories must have the same columns in `{ACTIONS}`, or none; they have {len(kinds)} kinds.",
                hint="Give each trajectory its actions, or none.",
            )
        ((names, action_size),) = kinds
        self._spec = DatasetSpec(
            fps=fps,
            cameras={camera: _shape(files, size) for camera, files in self._recordings[0].cameras.items()},
            action=ActionSpec(size=action_size, choices=0, names=names),
            robot_type="",
            skills=tuple(sorted({skill for skills in self._skills.values() for skill in skills})),
            has_scaled_actions=False,
        )

    @property
    def spec(self) -> DatasetSpec:
        """Properties that the trajectories share."""
        return self._spec

    def __len__(self) -> int:
        return len(self._recordings)

    def __iter__(self) -> Iterator[Trajectory]:
        for recording, (_, values) in zip(self._recordings, self._actions, strict=True):
            frames = {
                camera: self._frames(recording, files, self._spec.cameras[camera])
                for camera, files in recording.cameras.items()
            }
            length = _common_length(recording, frames)
            actions = values if self._spec.has_actions else np.empty((length, 0), np.float32)
            if len(actions) != length:
                raise InvalidInput(
                    f"`{recording.name}/{ACTIONS}` must have a line for each of {length} images; "
                    f"it has {len(actions)}.",
                    hint="The action of an image is executed after it; repeat the last one for the last image.",
                )
            cut = {camera: each[:length] for camera, each in frames.items()}
            yield Trajectory(cut, actions, self._skills.get(recording.name, ()))

    def _frames(self, recording: _Recording, files: Files, shape: tuple[int, int, int]) -> Pixels:
        """Returns the frames of a camera, uint8 (T, H, W, C)."""
        if isinstance(files, Path):
            return _video_frames(files, shape, fps=self._spec.fps)
        return joined((_pixels(file, self._size, shape) for file in files), shape)


class ImageSource(Source):
    """Unlabelled images of a folder, and of the folders in it, as trajectories without actions or tags.

    A run of images in the order of their names is a trajectory, about 50 in all, so that held-out images are others.

    Args:
        folder: Holds PNG, JPEG or WebP files.
        size: Height and width to scale images to; None for those of the first image, with a shorter side of 128: how
            things lie to one another is told in its proportions.

    Raises:
        NotFound: There are fewer than two images.
    """

    def __init__(self, folder: Path, *, size: tuple[int, int] | None = None) -> None:
        by_folder: dict[Path, list[Path]] = {}
        for file in sorted(folder.rglob("*"), key=_natural) if folder.is_dir() else ():
            if _is_image(file) and not any(part[0] == "." for part in file.relative_to(folder).parts):
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
        shape = (*(size or _scaled_size(self._runs[0][0])), 3)
        self._spec = DatasetSpec(1, {CAMERA: shape}, ActionSpec(0, 0, ()), robot_type="")

    @property
    def spec(self) -> DatasetSpec:
        """Properties that the trajectories share."""
        return self._spec

    def __len__(self) -> int:
        return len(self._runs)

    def __iter__(self) -> Iterator[Trajectory]:
        shape = self._spec.cameras[CAMERA]
        for files in self._runs:
            frames = joined((_pixels(file, shape[:2], shape) for file in files), shape)
            yield Trajectory({CAMERA: frames}, np.empty((len(files), 0), np.float32))


def _recordings(folder: Path) -> list[_Recording]:
    entries = _entries(folder)
    recordings = {each: recording for each in entries if (recording := _recording(each)) is not None}
    if not recordings:
        raise NotFound(
            "The folder must hold a folder of images, or a video (mp4 or mov), for each trajectory; it holds neither.",
            hint="Name the folder that holds the trajectories, or `meta` of a LeRobotDataset; for the MIME dataset add "
            "--layout mime.",
        )
    _check_all_read(entries, recordings)
    found = list(recordings.values())
    cameras = set(found[0].cameras)
    for each in found:
        if set(each.cameras) != cameras:
            raise InvalidInput(
                f"All trajectories must have the same cameras, {', '.join(sorted(cameras))}; `{each.name}` has others.",
                hint="Name the folders, or videos, of a trajectory alike in all.",
            )
    names = [each.name for each in found]
    if len(set(names)) != len(names):
        raise InvalidInput(
            "Trajectories must have different names; a folder and a video share one.", hint="Rename one."
        )
    return found


def _entries(folder: Path) -> list[Path]:
    """Returns what is visible in a folder, in the order of names; nothing where there is no folder."""
    visible = (each for each in folder.iterdir() if each.name[0] != ".") if folder.is_dir() else ()
    return sorted(visible, key=_natural)


def _recording(entry: Path) -> _Recording | None:
    """Returns what a file or folder records; None for another."""
    if entry.is_file():
        return _Recording(entry.stem, {CAMERA: entry}) if _is_video(entry) else None
    inside = _entries(entry)
    videos = [each for each in inside if _is_video(each)]
    folders = {each: files for each in inside if each.is_dir() and (files := _images(each))}
    own = _images(entry)
    cameras: list[tuple[str, Files]] = [(each.stem, each) for each in videos]
    cameras += [(each.name, files) for each, files in folders.items()]
    cameras += [(CAMERA, own)] if own else []
    if not cameras:
        return None
    _check_all_read(inside, [*videos, *folders, *own])
    for each, files in folders.items():
        _check_all_read(_entries(each), files)
    _check_different([name for name, _ in cameras], entry, "recordings of a camera")
    actions = entry / ACTIONS
    return _Recording(entry.name, dict(cameras), actions if actions.is_file() else None)


def _images(folder: Path) -> tuple[Path, ...]:
    """Returns the images in a folder, in the order of their names."""
    files = tuple(filter(_is_image, _entries(folder)))
    by_time = tuple(sorted(files, key=_by_decimals))
    if by_time != files and not all(_TIME.search(each.stem) for each in files):
        raise InvalidInput(
            f"The names of the images in `{folder.name}` must have one order; with dots, as in `{files[0].name}`, they "
            "have two: of whole numbers, and of decimal ones.",
            hint="Rename them: 0001.png, 0002.png, ...",
        )
    if files:
        _check_different([each.stem for each in files], folder, "images of a timestep")
    return by_time


def _check_all_read(entries: Sequence[Path], read: Collection[Path]) -> None:
    """Raises InvalidInput for what is not read, and might be a recording: later ones would take its place."""
    for each in entries:
        if each not in read and not (each.is_file() and each.suffix.lower() in _NOTES):
            raise InvalidInput(
                f"`{each.parent.name}/{each.name}` must be a folder of images, an image (PNG, JPEG or WebP) or a video "
                "(mp4 or mov); it is not.",
                hint="Convert it, or move it out of the folder.",
            )


def _check_different(names: Sequence[str], folder: Path, noun: str) -> None:
    """Raises InvalidInput where a name is there twice."""
    for name, count in Counter(names).items():
        if count > 1:
            raise InvalidInput(
                f"`{folder.name}` must have different names for {noun}; {count} are named `{name}`.",
                hint="Rename or remove all but one.",
            )


def _actions(recording: _Recording) -> tuple[tuple[str, ...], npt.NDArray[np.float32]]:
    """Returns the names of an action's numbers, if any, and the actions, float32 (T, A); A is 0 without actions."""
    if recording.actions is None:
        return (), np.empty((0, 0), np.float32)
    names, values = read_actions(recording.actions.read_bytes(), file=f"{recording.name}/{ACTIONS}")
    return names, values.astype(np.float32)


def _shape(files: Files, size: tuple[int, int] | None) -> tuple[int, int, int]:
    """Returns (H, W, C) of a camera's frames."""
    if isinstance(files, Path):
        with open_video(files, bounds=BOUNDS, field=files.name) as video:
            return (*(size or (video.info.height, video.info.width)), 3)
    height, width, channels = _decoded(files[0]).shape
    return (*(size or (height, width)), channels)


def _scaled_size(file: Path) -> tuple[int, int]:
    """Returns the height and width of an image after scaling its shorter side to `_SHORTER`."""
    height, width, _ = _decoded(file).shape
    scale = _SHORTER / min(height, width)
    return min(_LONGEST, round(height * scale)), min(_LONGEST, round(width * scale))


def _pixels(file: Path, size: tuple[int, int] | None, shape: tuple[int, int, int]) -> Pixels:
    """Returns an image, uint8 (H, W, C); gray ones become RGB where the first is."""
    pixels = _decoded(file)
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
    data, name = file.read_bytes(), f"{file.parent.name}/{file.name}"
    return images.decode(Image(images.sniff(data, field=name), 0, 0, data), field=name)


def _video_frames(file: Path, shape: tuple[int, int, int], *, fps: int) -> Pixels:
    """Returns the frames of a video at a rate, uint8 (T, H, W, C)."""
    with open_video(file, channels=shape[2], size=shape[:2], bounds=BOUNDS, field=file.name) as video:
        return joined(frames_at_rate(video, fps=fps, file=file.name), shape)


def _common_length(recording: _Recording, frames: Mapping[str, Pixels]) -> int:
    """Returns the timesteps of a trajectory; videos may end a frame apart."""
    lengths = sorted(map(len, frames.values()))
    slack = 1 if any(isinstance(files, Path) for files in recording.cameras.values()) else 0
    if lengths[-1] - lengths[0] > slack:
        raise InvalidInput(
            f"All cameras of a trajectory must have as many images; those of `{recording.name}` have {lengths[0]} to "
            f"{lengths[-1]}.",
            hint="Leave out what one camera did not see.",
        )
    return lengths[0]


def _is_image(path: Path) -> bool:
    return path.suffix.lower() in _IMAGES


def _is_video(path: Path) -> bool:
    return path.is_file() and path.suffix.lower() in _VIDEOS


def _natural(path: Path) -> list[tuple[Decimal, str]]:
    """Returns a key that orders paths by the value of the whole numbers in them: `2.png` before `10.png`."""
    return _numbers(_WHOLE.findall(path.as_posix()))


def _by_decimals(path: Path) -> list[tuple[Decimal, str]]:
    """Returns a key that orders files of a folder by the value of the decimal numbers: `1.05.png` before `1.5.png`."""
    return _numbers(_DECIMAL.findall(path.stem))


def _numbers(parts: Sequence[str]) -> list[tuple[Decimal, str]]:
    return [(Decimal(part), "") if part[0].isdecimal() else (Decimal(-1), part) for part in parts]
