"""Assignment of files in a person's folder to trajectories and cameras; ambiguous names are refused.

    <folder>/<trajectory>/0.png, 1.png, ...            images of one camera, in the order of their numbers or times
             <trajectory>/<camera>/0.png, ...          or of several
             <trajectory>/<camera>.mp4                 or videos
             <trajectory>.mp4                          or one video alone (mp4, m4v or mov)
             <trajectory>/actions.csv                  the action of each image in a line, below a line of names or not
             tags.csv                                  lines such as `<trajectory>,reach;pour` below `trajectory,skills`

Trajectories are in the order of their names, numbers in them by value. Hidden files and those of operating systems are
not looked at.
"""

import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

from freerein.data.image_names import in_order, natural
from freerein.errors import InvalidInput, NotFound

CAMERA = "camera"
"""Name of the camera of images or of a video that name none."""

ACTIONS, TAGS = "actions.csv", "tags.csv"
_IMAGES, _VIDEOS = frozenset((".png", ".jpg", ".jpeg", ".webp")), frozenset((".mp4", ".m4v", ".mov"))
_NEAR = 0.85
"""Likeness of names, by `difflib`, from which one might be meant for another."""

_NOTES = frozenset((".csv", ".json", ".md", ".txt"))
"""Suffixes of files that may lie beside images and videos and are not read, but for the tables."""

_SYSTEM = frozenset(
    [
        "thumbs.db",
        "ehthumbs.db",
        "desktop.ini",
        "icon\r",
        "picasa.ini",
        "__macosx",
        "@eadir",
        "#recycle",
        "$recycle.bin",
        "system volume information",
        "lost+found",
    ]
)
"""Names, in lower case, of files and folders that operating systems and storage devices make by themselves."""

_MOST_NAMED = 3

_DEVICE = re.compile(
    r"""
    \w*cams? | \w*cameras? | \w*views? | lens | sensor | kinect | realsense | zed | azure | orbbec | oak | basler
    | logitech | gopro | usb | phone | iphone | ipad | images? | imgs? | pictures? | pics? | photos? | frames? | pixels
    | video | observation | colou?r | rgb | gr[ae]y | depth | ir | infrared | mono | stereo | fisheye
    """,
    re.VERBOSE,
)
_PLACE = re.compile(
    r"""
    left | right | top | bottom | upper | lower | high | low | front | back | rear | side | cent(?:er|re|ral)
    | overhead | ceiling | bird | birdseye | ego | egocentric | ext | external | exo | exterior | first | third | person
    | main | primary | secondary | global | scene | static | wide | table | workspace | robot | wrist | in | (?:in)?hand
    | eye | gripper | head | chest | shoulder | base
    """,
    re.VERBOSE,
)
_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+")

Files = Path | tuple[Path, ...]
"""A video, or images in order."""


@dataclass(frozen=True)
class Recording:
    """The files of a trajectory: by camera, and of its actions, if any."""

    name: str
    cameras: Mapping[str, Files]
    actions: Path | None = None


def find_recordings(folder: Path) -> tuple[Recording, ...]:
    """Returns the recordings in a folder.

    Raises:
        NotFound: The folder holds none.
        InvalidInput: It holds folders of trajectories instead; recordings differ in their cameras; two have one name;
            the images of one have several orders; a file might be a recording and cannot be read.
    """
    entries = _entries(folder)
    _check_level(folder, entries)
    recordings = {each: recording for each in entries if (recording := _recording(each)) is not None}
    if not recordings:
        raise NotFound(
            "The folder must hold a folder of images, or a video (mp4 or mov), for each trajectory; it holds neither.",
            hint="Name the folder that holds the trajectories, or `meta` of a LeRobotDataset; for the MIME dataset add "
            "--layout mime.",
        )
    found = tuple(recordings.values())
    _check_all_read([*_unread(entries, recordings), *(each for entry in recordings for each in _unread_in(entry))])
    _check_look_like_cameras(found)
    _check_same_cameras(found)
    if len({each.name for each in found}) != len(found):
        raise InvalidInput(
            "Trajectories must have different names; a folder and a video share one.", hint="Rename one."
        )
    return found


def system_files(folder: Path) -> Counter[str]:
    """Returns the names of the files and folders that are not looked at because systems made them, and how often."""
    levels = ("*", "*/*", "*/*/*")
    return Counter(path.name.strip() for level in levels for path in folder.glob(level) if is_of_system(path.name))


def is_of_system(name: str) -> bool:
    """Returns whether an operating system or a storage device makes a file or folder of a name by itself."""
    return name.lower() in _SYSTEM


def is_image(path: Path) -> bool:
    """Returns whether a file is named like an image."""
    return path.suffix.lower() in _IMAGES


def _entries(folder: Path) -> list[Path]:
    """Returns what is to be looked at in a folder, in the order of names; nothing where there is no folder."""
    visible = (each for each in folder.iterdir() if each.name[0] != ".") if folder.is_dir() else ()
    return sorted((each for each in visible if not is_of_system(each.name)), key=natural)


def _recording(entry: Path) -> Recording | None:
    """Returns what a file or folder records; None for another."""
    if entry.is_file():
        return Recording(entry.stem, {CAMERA: entry}) if _is_video(entry) else None
    cameras: list[tuple[str, Files]] = [(each.stem, each) for each in _entries(entry) if _is_video(each)]
    cameras += [(each.name, files) for each in _entries(entry) if each.is_dir() and (files := image_series(each))]
    cameras += [(CAMERA, own)] if (own := image_series(entry)) else []
    if not cameras:
        return None
    _check_different([name for name, _ in cameras], entry, "recordings of a camera")
    return Recording(entry.name, dict(cameras), table_in(entry, ACTIONS))


def table_in(folder: Path, name: str) -> Path | None:
    """Returns the table of a name in a folder, whatever its case; None where there is none.

    Raises:
        InvalidInput: There is another one of about that name, such as `action.csv` for `actions.csv`.
    """
    tables = [each for each in _entries(folder) if each.is_file() and each.suffix.lower() == ".csv"]
    found = next((each for each in tables if each.name.lower() == name), None)
    near = get_close_matches(name, [each.name.lower() for each in tables], n=1, cutoff=_NEAR)
    if found is None and near:
        raise InvalidInput(
            f"`{folder.name}/{near[0]}` is not read, and might be meant; the table must be called `{name}`.",
            hint=f"Rename it to `{name}`, or move it away.",
        )
    return found


def images_of(folder: Path) -> tuple[Path, ...]:
    """Returns the images in a folder, whole numbers in their names by value."""
    return tuple(filter(is_image, _entries(folder)))


def image_series(folder: Path) -> tuple[Path, ...]:
    """Returns the images in a folder in the order of the numbers, or times, in their names; raises as `in_order`."""
    files = images_of(folder)
    if files:
        _check_different([each.stem for each in files], folder, "images of a timestep")
    return in_order(files)


def _unread_in(entry: Path) -> Iterator[Path]:
    """Yields what is not read in the folder of a recording, and in those of its cameras."""
    inside = _entries(entry) if entry.is_dir() else []
    folders = [each for each in inside if each.is_dir() and any(map(is_image, _entries(each)))]
    yield from _unread(inside, [each for each in inside if each in folders or is_image(each) or _is_video(each)])
    for each in folders:
        yield from _unread(_entries(each), list(filter(is_image, _entries(each))))


def _unread(entries: Sequence[Path], read: Collection[Path]) -> list[Path]:
    return [each for each in entries if each not in read and not (each.is_file() and each.suffix.lower() in _NOTES)]


def _check_all_read(unread: Sequence[Path]) -> None:
    """Raises InvalidInput for what is not read, and might be a recording: later ones would take its place."""
    if not unread:
        return
    named = ", ".join(f"`{each.parent.name}/{each.name}`" for each in unread[:_MOST_NAMED])
    others = f" and {len(unread) - _MOST_NAMED} others" if len(unread) > _MOST_NAMED else ""
    they_are, them = ("it is", "it") if len(unread) == 1 else ("they are", "them")
    raise InvalidInput(
        f"{named}{others} must be a folder of images, an image (PNG, JPEG or WebP) or a video (mp4 or mov); "
        f"{they_are} not.",
        hint=f"Convert {them}, a video by ffmpeg -i IN -c:v libx264 OUT.mp4, or move {them} out of the folder.",
    )


def _check_level(folder: Path, entries: Sequence[Path]) -> None:
    """Raises InvalidInput where tables tell that the trajectories lie a folder higher, or deeper."""
    if (folder / ACTIONS).exists():
        raise InvalidInput(
            f"The folder must hold a folder for each trajectory; it holds `{ACTIONS}`, as that of a trajectory does.",
            hint="Name the folder that holds this one.",
        )
    for entry in filter(Path.is_dir, entries):
        deeper = [each / name for each in _entries(entry) if each.is_dir() for name in (ACTIONS, TAGS)]
        table = next((each for each in (entry / TAGS, *deeper) if each.exists()), None)
        if table is not None:
            raise InvalidInput(
                f"`{entry.name}` must be a trajectory; it holds `{table.relative_to(entry).as_posix()}`, as a folder "
                "of trajectories does.",
                hint=f"Name that folder instead: `{entry.name}`.",
            )


def _check_same_cameras(found: Sequence[Recording]) -> None:
    cameras = set(found[0].cameras)
    for each in found:
        if set(each.cameras) != cameras:
            raise InvalidInput(
                f"All trajectories must have the same cameras, {', '.join(sorted(cameras))}; `{each.name}` has others.",
                hint="Name the folders, or videos, of a trajectory alike in all. Where these are trajectories "
                "themselves, name their folder.",
            )


def _check_look_like_cameras(found: Sequence[Recording]) -> None:
    """Raises InvalidInput where what lies in the folder of a trajectory may be trajectories.

    A camera has a word for one in its name, or else no number, and as many images as the others in every trajectory.
    """
    lengths = [{len(files) for files in each.cameras.values() if not isinstance(files, Path)} for each in found]
    is_alike = len(found) > 1 and all(len(each) <= 1 for each in lengths)
    for recording in found:
        for name in recording.cameras:
            if not _is_named_like_a_camera(name) and (not is_alike or any(map(str.isdecimal, name))):
                raise InvalidInput(
                    f"`{recording.name}/{name}` must be named like a camera, such as `{recording.name}/top`: it may be "
                    "a trajectory itself.",
                    hint=f"If it is one, import the folder `{recording.name}`. If it is a camera, rename it: cam-1.",
                )


def _check_different(names: Sequence[str], folder: Path, noun: str) -> None:
    """Raises InvalidInput where a name is there twice."""
    for name, count in Counter(names).items():
        if count > 1:
            raise InvalidInput(
                f"`{folder.name}` must have different names for {noun}; {count} are named `{name}`.",
                hint="Rename or remove all but one.",
            )


def _is_video(path: Path) -> bool:
    return path.is_file() and path.suffix.lower() in _VIDEOS


def _is_named_like_a_camera(name: str) -> bool:
    """Returns whether a name has a word for a camera, or only words for where one is.

    `wrist_1` and `left-turn-cam` do, `left-turn-1` and `take-1` do not.
    """
    words = [word.lower() for word in _WORD.findall(name)]
    return any(map(_DEVICE.fullmatch, words)) or (bool(words) and all(map(_PLACE.fullmatch, words)))
