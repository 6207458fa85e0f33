"""What the reward model learns from: images, and how the things in them lie to one another, as captions tell it."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
import numpy.typing as npt

from freerein.errors import InvalidInput
from freerein.learning.split import train_validation_split
from freerein_reward.relations import WORDINGS, Relation, caption, judge

UNSAID = -1
"""In place of a relation: no caption tells of this pair."""

_MIRRORED = np.array([Relation.RIGHT_OF, Relation.LEFT_OF, Relation.ON_TOP_OF, Relation.BELOW, Relation.APART_FROM])

_USUAL = 0.7
"""How often a relation is worded as captions and goals of the sim word it."""


@dataclass(frozen=True, eq=False)
class Described:
    """Images with their captions.

    Attributes:
        views: By camera, uint8 (N, H, W, 3).
        phrases: P noun phrases.
        relations: int8 (N, P, P): the relation of the row's phrase to the column's, `UNSAID` where no caption tells.
        sides: int8 (N, P, P): on which side the row's phrase is, however far: `LEFT_OF`, `RIGHT_OF` or `UNSAID`.
    """

    views: tuple[npt.NDArray[np.uint8], ...]
    phrases: tuple[str, ...]
    relations: npt.NDArray[np.int8]
    sides: npt.NDArray[np.int8]

    def __len__(self) -> int:
        return len(self.relations)

    def subset(self, items: npt.NDArray[np.int64]) -> "Described":
        """Returns some of the images, int64 (n,)."""
        return Described(
            tuple(view[items] for view in self.views), self.phrases, self.relations[items], self.sides[items]
        )

    def mirrored(self, flips: npt.NDArray[np.bool_]) -> "Described":
        """Returns the images, those where `flips`, bool (N,), in a mirror: what was to the left is to the right."""
        views = tuple(np.where(flips[:, None, None, None], view[:, :, ::-1], view) for view in self.views)
        relations, sides = (
            np.where(flips[:, None, None] & (told != UNSAID), _MIRRORED[told], told).astype(np.int8)
            for told in (self.relations, self.sides)
        )
        return Described(views, self.phrases, relations, sides)

    def shifted(self, offsets: npt.NDArray[np.int64], *, most: int) -> "Described":
        """Returns the images moved by whole pixels, their edges repeated; how things lie to one another stays.

        Args:
            offsets: int64 (N, 2), rows and columns, in [-most, most].
            most: The greatest offset.
        """
        return Described(
            tuple(_shift(view, offsets, most) for view in self.views), self.phrases, self.relations, self.sides
        )


def pairs_of(count: int) -> npt.NDArray[np.int64]:
    """Returns every ordered pair of `count` phrases, int64 (pairs, 2)."""
    return np.array(list(permutations(range(count), 2)), np.int64)


def relations_of(
    x: npt.NDArray[np.float64], y: npt.NDArray[np.float64], shown: npt.NDArray[np.bool_], *, epsilon: float
) -> npt.NDArray[np.int8]:
    """Returns how all things lie to one another by table 4.1, int8 (N, P, P), `UNSAID` where one is not shown.

    Args:
        x: (N, P), to the right.
        y: (N, P), down.
        shown: (N, P).
        epsilon: A thing's width, in the unit of x and y.
    """
    places = np.stack([x, y], axis=-1)  # (N, P, 2)
    told = judge(places[:, :, None], places[:, None], epsilon=epsilon)  # (N, P, P)
    both = shown[:, :, None] & shown[:, None] & ~np.eye(x.shape[1], dtype=bool)
    return np.where(both, told, UNSAID).astype(np.int8)


def sides_of(x: npt.NDArray[np.float64], relations: npt.NDArray[np.int8]) -> npt.NDArray[np.int8]:
    """Returns table 4.1's first two criteria by themselves, int8 (N, P, P), of x (N, P), where captions tell."""
    left = np.where(x[:, :, None] < x[:, None], Relation.LEFT_OF, Relation.RIGHT_OF)
    return np.where(relations == UNSAID, UNSAID, left).astype(np.int8)


def told_of(told: npt.NDArray[np.int8]) -> npt.NDArray[np.int64]:
    """Returns what is told of every ordered pair, int64 (N, pairs), of int8 (N, P, P)."""
    first, second = pairs_of(told.shape[1]).T
    return told[:, first, second].astype(np.int64)


def sentences(
    phrases: Sequence[str], pairs: npt.NDArray[np.int64], *, rng: np.random.Generator | None = None
) -> tuple[str, ...]:
    """Returns for each pair (pairs, 2) the sentence with each relation, in the order of `Relation`.

    Args:
        phrases: The noun phrases.
        pairs: Places in `phrases`.
        rng: Draws other wordings here and there; none for the usual ones.
    """
    return tuple(
        caption(phrases[first], relation, phrases[second], wording=_wording(relation, rng))
        for first, second in pairs
        for relation in Relation
    )


def hold_out(
    described: Described, lengths: npt.NDArray[np.int64], *, share: float, seed: int
) -> tuple[Described, Described]:
    """Returns the images to learn from and those held out, the images of a random share of the trajectories.

    Images without a caption are in neither.

    Args:
        described: N images.
        lengths: int64 (n,), the timesteps of each trajectory, N together.
        share: Of the trajectories.
        seed: Of the choice.

    Raises:
        InvalidInput: There is only one trajectory, or no caption on one of the two sides.
    """
    if len(lengths) < 2:
        raise InvalidInput("A fit needs at least 2 trajectories, one of them to hold out; got 1.", field="dataset")
    trajectories = np.repeat(np.arange(len(lengths)), lengths)  # (N,)
    has_caption = (described.relations != UNSAID).any(axis=(1, 2))
    training, validation = (
        np.flatnonzero(has_caption & np.isin(trajectories, side))
        for side in train_validation_split(np.arange(len(lengths)), fraction=share, seed=seed)
    )
    if not len(training) or not len(validation):
        raise InvalidInput(
            f"Images to learn from and images held out must show two of the {len(described.phrases)} things that the "
            f"phrases name; {len(training)} and {len(validation)} do.",
            field="config.phrases",
            hint="Try the phrases on one image with Ground, and name things by their colours.",
        )
    return described.subset(training), described.subset(validation)


def _wording(relation: Relation, rng: np.random.Generator | None) -> str:
    wordings = WORDINGS[relation]
    if rng is None or rng.random() < _USUAL:
        return wordings[0]
    return wordings[rng.integers(len(wordings))]


def _shift(view: npt.NDArray[np.uint8], offsets: npt.NDArray[np.int64], most: int) -> npt.NDArray[np.uint8]:
    height, width = view.shape[1:3]
    padded = np.pad(view, ((0, 0), (most, most), (most, most), (0, 0)), mode="edge")
    return np.stack(
        [
            image[row : row + height, column : column + width]
            for image, (row, column) in zip(padded, offsets + most, strict=True)
        ]
    )
