"""The caption dataset of a reward model: images, and the spatial relations that the grounding model found in them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from freerein.atomic_files import write_atomic
from freerein.data import Dataset
from freerein.errors import InvalidInput
from freerein.jobs.metrics import MetricsWriter
from freerein.learning import tensor_files
from freerein.learning.augmentation import augment_camera
from freerein.learning.split import train_validation_split
from freerein.relations import SpatialRelation, absence_caption, caption
from freerein_reward.methods.relation_captions.config import RewardConfig
from freerein_reward.methods.shared.frames import resized
from freerein_reward.methods.shared.presence import alone_in_place, presence_in_dataset
from freerein_reward.model import PhraseLocator
from freerein_reward.model.phrase_relations import NO_CAPTION, pairwise_relations

ABSENT = len(SpatialRelation)
"""Instead of a relation: one of the two is surely missing."""

CAPTIONS = len(SpatialRelation) + 1
"""Captions of a pair: one of each relation, and that one of the two is missing."""

_MIRRORED = np.array(
    [
        SpatialRelation.RIGHT_OF,
        SpatialRelation.LEFT_OF,
        SpatialRelation.ON_TOP_OF,
        SpatialRelation.BELOW,
        SpatialRelation.APART_FROM,
        ABSENT,
    ]
)
_IMAGES_AT_ONCE = 256
_UNSURE = 0.5


@dataclass(frozen=True, eq=False)
class CaptionDataset:
    """Images with captions.

    Attributes:
        views: uint8 (N, H, W, 3) per camera.
        phrases: P noun phrases.
        relations: int8 (N, P, P), relation of the row's phrase to the column's, `ABSENT` or `NO_CAPTION`.
        half_heat: float64 (P,), peak heat from which a phrase is rather shown than not, in units of the grounding
            model's.
        keypoints: float32 (N, P, 3), where the grounding model found each phrase in the first view, as
            `RelationPool.keypoints` has it; None where nobody kept it.
    """

    views: tuple[npt.NDArray[np.uint8], ...]
    phrases: tuple[str, ...]
    relations: npt.NDArray[np.int8]
    half_heat: npt.NDArray[np.float64]
    keypoints: npt.NDArray[np.float32] | None = None

    def __len__(self) -> int:
        return len(self.relations)

    def subset(self, items: npt.NDArray[np.int64]) -> "CaptionDataset":
        """Returns the images at some indices, int64 (n,)."""
        views = tuple(view[items] for view in self.views)
        keypoints = None if self.keypoints is None else self.keypoints[items]
        return replace(self, views=views, relations=self.relations[items], keypoints=keypoints)

    def mirrored(self, flips: npt.NDArray[np.bool_]) -> "CaptionDataset":
        """Returns the dataset with the images where `flips`, bool (N,), mirrored left to right, captions included."""
        views = tuple(np.where(flips[:, None, None, None], view[:, :, ::-1], view) for view in self.views)
        is_turned = flips[:, None, None] & (self.relations != NO_CAPTION)
        relations = np.where(is_turned, _MIRRORED[self.relations], self.relations).astype(np.int8)
        keypoints = None if self.keypoints is None else np.where(flips[:, None, None], [1, -1, 1], 1) * self.keypoints
        return replace(self, views=views, relations=relations, keypoints=keypoints)

    def augmented(self, strength: float, *, generator: torch.Generator) -> "CaptionDataset":
        """Returns the dataset as other cameras would have seen it, the views of an image alike; captions stay.

        Keypoints do not: nobody knows where phrases are now.
        """
        takes = torch.arange(len(self)).repeat(len(self.views))
        frames = torch.from_numpy(np.concatenate(self.views))
        seen = augment_camera(frames, takes, strength=strength, generator=generator).numpy()
        return replace(self, views=tuple(np.split(seen, len(self.views))), keypoints=None)

    def split(
        self, lengths: npt.NDArray[np.int64], *, fraction: float, seed: int
    ) -> tuple["CaptionDataset", "CaptionDataset"]:
        """Returns the training and the validation images, of whole trajectories; images without captions are dropped.

        `lengths`, int64 (n,), are the timesteps of each trajectory, with sum N; `fraction` is the validation part's.
        Raises InvalidInput when there is only one trajectory, or a side has no captions.
        """
        trajectories = np.repeat(np.arange(len(lengths)), lengths)  # (N,)
        has_caption = (self.relations != NO_CAPTION).any(axis=(1, 2))
        is_related = ((self.relations != NO_CAPTION) & (self.relations != ABSENT)).any(axis=(1, 2))
        sides = [
            np.isin(trajectories, side)
            for side in train_validation_split(np.arange(len(lengths)), fraction=fraction, seed=seed)
        ]
        related = [int((is_related & side).sum()) for side in sides]
        if not all(related):
            raise InvalidInput(
                f"Training and validation images must show two of the {len(self.phrases)} phrases; "
                f"{related[0]} and {related[1]} images do.",
                field="config.phrases",
                hint="Try the phrases on one image with `Ground`; name objects by colour.",
            )
        training, validation = (self.subset(np.flatnonzero(has_caption & side)) for side in sides)
        return training, validation


def caption_images(
    dataset: Dataset, grounding: PhraseLocator, config: RewardConfig, path: Path, *, size: int
) -> CaptionDataset:
    """Returns a dataset's images, of height and width `size`, with a caption for each ordered pair of phrases shown.

    The phrases are located in the frames of the first camera, and related in units of their width. `path` is a cache of
    the captions, read when it exists, else written; `metrics.jsonl` beside it then has the fraction done, `captioned`,
    at step 0.
    """
    steps = [dataset.cached_frames(camera).steps for camera in config.cameras]
    views = tuple(resized(frames, size) for frames in steps)
    aspect = steps[0].shape[1] / steps[0].shape[2]
    if path.is_file():
        cached = tensor_files.parse(path.read_bytes())
        relations, half_heat = cached["relations"].numpy(), cached["half_heat"].numpy()
        keypoints = cached["keypoints"].numpy() if "keypoints" in cached else None  # of an earlier version
    else:
        rows = MetricsWriter(path.with_name("metrics.jsonl"), last_step=-1)
        x, y, heat, presence = _located(steps[0], grounding, config, rows)
        relations, half_heat = image_relations(x, y * aspect, heat, presence, config)
        keypoints = place_keypoints(x, y, heat, presence)
        found = {"relations": relations, "half_heat": half_heat, "keypoints": keypoints}
        write_atomic(path, tensor_files.dump({name: torch.from_numpy(each) for name, each in found.items()}))
    return CaptionDataset(views, config.phrases, relations, half_heat, keypoints)


def ordered_pairs(count: int) -> npt.NDArray[np.int64]:
    """Returns every ordered pair of `count` phrases, int64 (pairs, 2)."""
    return np.array(list(permutations(range(count), 2)), np.int64)


def pairwise_absences(presence: npt.NDArray[np.float64], *, least: float) -> npt.NDArray[np.bool_]:
    """Returns which ordered pairs are surely not both shown, bool (N, P, P), False for a phrase and itself.

    `presence` are probabilities, float64 (N, P); one below 1 - `least` is sure.
    """
    is_missing = presence < 1 - least
    return (is_missing[:, :, None] | is_missing[:, None]) & ~np.eye(presence.shape[1], dtype=bool)


def flatten_pairs(values: npt.NDArray[np.int8]) -> npt.NDArray[np.int64]:
    """Returns int8 (N, P, P) without its diagonal, in the order of `ordered_pairs`: int64 (N, pairs)."""
    first, second = ordered_pairs(values.shape[1]).T
    return values[:, first, second].astype(np.int64)


def pair_captions(phrases: Sequence[str], pairs: npt.NDArray[np.int64]) -> tuple[str, ...]:
    """Returns the `CAPTIONS` captions of each pair, int64 (pairs, 2): with each relation, and that one is missing."""
    return tuple(
        text
        for first, second in ((phrases[first], phrases[second]) for first, second in pairs)
        for text in (*(caption(first, each, second) for each in SpatialRelation), absence_caption(first, second))
    )


def image_relations(
    x: npt.NDArray[np.float64],
    y: npt.NDArray[np.float64],
    heat: npt.NDArray[np.float64],
    presence: npt.NDArray[np.float64],
    config: RewardConfig,
) -> tuple[npt.NDArray[np.int8], npt.NDArray[np.float64]]:
    """Returns the relations, int8 (N, P, P), of phrases that were located in N images, float64 (N, P), and `half_heat`.

    `x` and `y` are fractions of the image width, as is `config.epsilon`; `heat` and `presence` are those of
    `PhraseLocations`.
    """
    judged = presence_in_dataset(heat, presence)
    is_alone = alone_in_place(x, y, judged.probability, heat, epsilon=config.epsilon)
    probability = np.where(is_alone, judged.probability, np.minimum(judged.probability, _UNSURE))
    shown = pairwise_relations(x, y, probability >= config.min_presence, epsilon=config.epsilon)
    absent = pairwise_absences(probability, least=config.min_presence)
    return np.where(absent, ABSENT, shown).astype(np.int8), judged.half_heat


def place_keypoints(
    x: npt.NDArray[np.float64],
    y: npt.NDArray[np.float64],
    heat: npt.NDArray[np.float64],
    presence: npt.NDArray[np.float64],
) -> npt.NDArray[np.float32]:
    """Returns the keypoints, float32 (N, P, 3), of phrases that were located in N images, as in `PhraseLocations`."""
    shown = presence_in_dataset(heat, presence).probability
    return np.stack([(2 * y - 1) * shown, (2 * x - 1) * shown, shown], axis=2).astype(np.float32)


def _located(
    frames: npt.NDArray[np.uint8], grounding: PhraseLocator, config: RewardConfig, rows: MetricsWriter
) -> npt.NDArray[np.float64]:
    """Returns x, y, heat and presence of each phrase in frames (N, H, W, C), float64 (4, N, P)."""
    parts = []
    for start in range(0, len(frames), _IMAGES_AT_ONCE):
        seen = resized(frames[start : start + _IMAGES_AT_ONCE], grounding.image_size)
        found = grounding.ground(seen, config.phrases)
        parts.append(np.stack([found.x, found.y, found.heat, found.presence]))
        rows.append(0, {"captioned": min(1.0, (start + _IMAGES_AT_ONCE) / len(frames))})
    return np.concatenate(parts, axis=1)
