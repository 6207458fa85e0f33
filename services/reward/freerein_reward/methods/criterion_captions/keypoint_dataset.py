"""The keypoints of a dataset's noun phrases, as the grounding model finds them in each camera."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from freerein.atomic_files import write_atomic
from freerein.criteria import CONTAINER, View, criteria
from freerein.data import Dataset
from freerein.errors import InvalidInput
from freerein.jobs.metrics import MetricsWriter
from freerein.learning import tensor_files
from freerein.learning.split import train_validation_split
from freerein_reward.methods.criterion_captions.captions import HIDDEN, SHOWN, UNSURE, Labels, label_captions
from freerein_reward.methods.criterion_captions.config import CriterionConfig
from freerein_reward.methods.criterion_captions.spec import NO_CAMERA
from freerein_reward.methods.shared.frames import resized
from freerein_reward.methods.shared.presence import alone_in_place, presence_in_dataset
from freerein_reward.model import PhraseLocator

_IMAGES_AT_ONCE = 256
_APART = 0.7
"""Distance of two things, in object widths, from which the one of less heat is no part of the other: flat things lie on
each other at less than a width."""

_SEEN = 0.5
"""Presence from which the grounding model sees a phrase."""

Frames = npt.NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class ViewLayout:
    """How cameras are the views of table 4.1.

    Attributes:
        cameras: The number of each view's camera; None for a view that there is not.
        units: float64 (views, 2), object width to the right and down in each view, as a fraction of the frame's width
            and height.
        container_width: Of what contains other things, in object widths.
    """

    cameras: tuple[int | None, ...]
    units: npt.NDArray[np.float64]
    container_width: float = CONTAINER

    @property
    def views(self) -> tuple[View, ...]:
        """The views that there are."""
        return tuple(view for view, camera in zip(View, self.cameras, strict=True) if camera is not None)

    def unit(self, camera: int) -> npt.NDArray[np.float64]:
        """Returns the object width in a camera's frames as a fraction of their width and height, float64 (2,)."""
        unit: npt.NDArray[np.float64] = self.units[self.cameras.index(camera)]
        return unit

    @property
    def is_mirrored(self) -> bool:
        """Whether a mirrored frame shows a possible scene: with cameras of several sides it does not."""
        return len({each for each in self.cameras if each is not None}) == 1 and View.SIDE not in self.views


@dataclass(frozen=True, eq=False)
class KeypointDataset:
    """N moments seen by V cameras, and where P phrases are.

    Attributes:
        frames: uint8 (N, H, W, 3) per camera.
        keypoints: float32 (N, V, P, 2), x and y as fractions of width and height.
        shown: int8 (N, V, P), `SHOWN`, `HIDDEN` or `UNSURE`.
        layout: Which camera is which view.
    """

    frames: tuple[Frames, ...]
    keypoints: npt.NDArray[np.float32]
    shown: Labels
    layout: ViewLayout

    def __len__(self) -> int:
        return len(self.keypoints)

    def subset(self, items: npt.NDArray[np.int64]) -> "KeypointDataset":
        """Returns the moments at some indices, int64 (n,)."""
        frames = tuple(each[items] for each in self.frames)
        return replace(self, frames=frames, keypoints=self.keypoints[items], shown=self.shown[items])

    def mirrored(self, flips: npt.NDArray[np.bool_]) -> "KeypointDataset":
        """Returns the dataset with the frames where `flips`, bool (N,), mirrored left to right, keypoints included."""
        frames = tuple(np.where(flips[:, None, None, None], each[:, :, ::-1], each) for each in self.frames)
        keypoints = self.keypoints.copy()
        keypoints[flips, ..., 0] = 1 - keypoints[flips, ..., 0]
        return replace(self, frames=frames, keypoints=keypoints)

    def captions(self, tuples: npt.NDArray[np.int64], *, tolerance: float) -> Labels:
        """Returns whether captions hold; see `label_captions`."""
        count, _, phrases, _ = self.keypoints.shape
        keypoints = np.zeros((count, len(View), phrases, 2))
        shown = np.full((count, len(View), phrases), UNSURE, np.int8)
        for view in self.layout.views:
            camera = self.layout.cameras[view]
            keypoints[:, view] = self.keypoints[:, camera] / self.layout.units[view]
            shown[:, view] = self.shown[:, camera]
        named = criteria(container_width=self.layout.container_width).values()
        return label_captions(keypoints, shown, tuples, criteria=named, views=self.layout.views, tolerance=tolerance)

    def split(
        self, lengths: npt.NDArray[np.int64], *, fraction: float, seed: int
    ) -> tuple["KeypointDataset", "KeypointDataset"]:
        """Returns the training and the validation moments, of whole trajectories.

        `lengths`, int64 (n,), are the timesteps of each trajectory, with sum N; `fraction` is the validation part's.
        Raises InvalidInput when there is only one trajectory, or a side never shows two phrases at once.
        """
        trajectories = np.repeat(np.arange(len(lengths)), lengths)  # (N,)
        sides = [
            np.flatnonzero(np.isin(trajectories, side))
            for side in train_validation_split(np.arange(len(lengths)), fraction=fraction, seed=seed)
        ]
        shows_two = (self.shown == SHOWN).sum(axis=2).max(axis=1) >= 2
        counts = [int(shows_two[side].sum()) for side in sides]
        if not all(counts):
            raise InvalidInput(
                f"Training and validation images must show two of the {self.keypoints.shape[2]} phrases; "
                f"{counts[0]} and {counts[1]} images do.",
                field="config.phrases",
                hint="Try the phrases on one image with `Ground`; name objects by colour.",
            )
        training, validation = (self.subset(side) for side in sides)
        return training, validation


def view_layout(
    cameras: Sequence[str],
    views: Sequence[str],
    widths: Sequence[float],
    aspect: float,
    *,
    depth: float = 0.0,
    container_width: float = CONTAINER,
) -> ViewLayout:
    """Returns which camera is which view.

    Args:
        cameras: Camera names.
        views: The camera of each view, `NO_CAMERA` for none.
        widths: Object width as a fraction of the frame's width, one for all views or one for each.
        aspect: Height of the frames over their width.
        depth: Object width in depth as the tilted view shows it, as a fraction of the frame's width; 0 for its width.
        container_width: Of what contains other things, in object widths.
    """
    numbers = tuple(None if name == NO_CAMERA else cameras.index(name) for name in views)
    across = np.broadcast_to(np.asarray(widths, np.float64), len(View))
    down = across.copy()
    down[View.TILTED] = depth or down[View.TILTED]
    return ViewLayout(numbers, np.stack([across, down / aspect], axis=1), container_width)


def locate_phrases(
    dataset: Dataset, grounding: PhraseLocator, config: CriterionConfig, layout: ViewLayout, path: Path
) -> KeypointDataset:
    """Returns a dataset's moments with the keypoints of the phrases in each camera.

    `path` caches the keypoints, read when it exists, else written; `metrics.jsonl` beside it then has the fraction
    done, `captioned`, at step 0.
    """
    size = grounding.image_size
    steps = [dataset.cached_frames(camera).steps for camera in config.cameras]
    frames = tuple(resized(each, size) for each in steps)
    if path.is_file():
        cached = tensor_files.parse(path.read_bytes())
        keypoints, shown = cached["places"].numpy(), cached["shown"].numpy()
    else:
        rows = MetricsWriter(path.with_name("metrics.jsonl"), last_step=-1)
        keypoints, shown = find_keypoints(frames, grounding, config, layout, rows)
        tensors = {"places": torch.from_numpy(keypoints), "shown": torch.from_numpy(shown)}
        write_atomic(path, tensor_files.dump(tensors))
    return KeypointDataset(frames, keypoints, shown, layout)


def find_keypoints(
    frames: Sequence[Frames],
    grounding: PhraseLocator,
    config: CriterionConfig,
    layout: ViewLayout,
    rows: MetricsWriter | None = None,
) -> tuple[npt.NDArray[np.float32], Labels]:
    """Returns the keypoints of the phrases, float32 (N, V, P, 2), and whether they are shown, int8 (N, V, P).

    `frames` are uint8 (N, H, W, 3) per camera.
    """
    keypoints, shown = [], []
    for camera, view in enumerate(frames):
        parts = []
        for start in range(0, len(view), _IMAGES_AT_ONCE):
            found = grounding.ground(view[start : start + _IMAGES_AT_ONCE], config.phrases)
            parts.append(np.stack([found.x, found.y, found.heat, found.presence]))
            if rows:
                done = (camera + min(1.0, (start + _IMAGES_AT_ONCE) / len(view))) / len(frames)
                rows.append(0, {"captioned": done})
        x, y, heat, presence = np.concatenate(parts, axis=1)  # (N, P) each
        keypoints.append(np.stack([x, y], axis=2).astype(np.float32))
        unit = layout.unit(camera)
        shown.append(_shown(x / unit[0], y / unit[1], heat, presence, least=config.min_presence))
    return np.stack(keypoints, axis=1), np.stack(shown, axis=1)


def _shown(
    x: npt.NDArray[np.float64],
    y: npt.NDArray[np.float64],
    heat: npt.NDArray[np.float64],
    presence: npt.NDArray[np.float64],
    *,
    least: float,
) -> Labels:
    """Returns whether phrases are shown at keypoints in object widths, int8 (N, P).

    What is half covered has less heat than where the others are shown, and is not taken for hidden where the grounding
    model sees it.
    """
    probability = presence_in_dataset(heat, presence).probability
    is_alone = alone_in_place(x, y, probability, heat, epsilon=_APART)
    sure = np.where((probability < 1 - least) & (presence < _SEEN), HIDDEN, UNSURE)
    return np.where(is_alone & (probability >= least), SHOWN, sure).astype(np.int8)
