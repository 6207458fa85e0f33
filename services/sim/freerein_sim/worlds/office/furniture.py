"""Furniture: each kind is a few boxes, in metres, its front to the south before it is turned."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class Box:
    """An upright box.

    Attributes:
        low: Least x, y and z, in metres.
        high: Greatest x, y and z.
        texture: Name of its texture.
    """

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    texture: str


@dataclass(frozen=True)
class Piece:
    """A piece of furniture.

    Attributes:
        kind: One of `_KINDS`.
        x: Middle of its rectangle on the floor, in metres.
        y: The same along y.
        turns: Quarter turns to the left.
    """

    kind: str
    x: float
    y: float
    turns: int = 0

    def boxes(self) -> Iterator[Box]:
        """Yields its boxes where it stands."""
        for corner, other, texture in _KINDS[self.kind]:
            ends = np.sort([self._placed(corner), self._placed(other)], axis=0)
            low, high = ((float(x), float(y), z) for (x, y), z in zip(ends, sorted((corner[2], other[2])), strict=True))
            yield Box(low, high, texture)

    def rectangle(self) -> npt.NDArray[np.float64]:
        """Returns its rectangle on the floor, which the robot cannot enter: float64 (4,)."""
        boxes = list(self.boxes())
        low = np.min([box.low[:2] for box in boxes], axis=0)
        high = np.max([box.high[:2] for box in boxes], axis=0)
        return np.concatenate([low, high])

    def _placed(self, corner: tuple[float, float, float]) -> npt.NDArray[np.float64]:
        x, y, _ = corner
        for _ in range(self.turns % 4):
            x, y = -y, x
        return np.array([self.x + x, self.y + y])


_Part = tuple[tuple[float, float, float], tuple[float, float, float], str]


def _legs(half_x: float, half_y: float, top: float) -> tuple[_Part, ...]:
    """Returns side panels under a table top."""
    return tuple(((side * half_x, -half_y, 0), (side * (half_x - 0.05), half_y, top), "wood-dark") for side in (-1, 1))


_KINDS: dict[str, tuple[_Part, ...]] = {
    "desk": (
        *_legs(0.65, 0.3, 0.7),
        ((-0.7, -0.35, 0.7), (0.7, 0.35, 0.75), "wood"),
        ((0.25, -0.3, 0.1), (0.6, 0.3, 0.7), "drawers"),
        ((-0.3, 0.1, 0.85), (0.3, 0.16, 1.2), "screen"),
        ((-0.05, 0.1, 0.75), (0.05, 0.2, 0.9), "metal"),
    ),
    "table": (
        ((-0.25, -0.15, 0), (0.25, 0.15, 0.68), "metal"),
        ((-0.8, -0.45, 0.68), (0.8, 0.45, 0.75), "wood"),
    ),
    "chair": (
        ((-0.06, -0.06, 0), (0.06, 0.06, 0.42), "metal"),
        ((-0.24, -0.24, 0.42), (0.24, 0.24, 0.5), "fabric"),
        ((-0.22, 0.18, 0.5), (0.22, 0.24, 1.0), "fabric"),
    ),
    "sofa": (
        ((-0.8, -0.4, 0), (0.8, 0.4, 0.42), "fabric"),
        ((-0.8, 0.2, 0.42), (0.8, 0.4, 0.85), "fabric"),
        ((-0.8, -0.4, 0.42), (-0.65, 0.2, 0.62), "fabric-dark"),
        ((0.65, -0.4, 0.42), (0.8, 0.2, 0.62), "fabric-dark"),
    ),
    "bookshelf": (
        ((-0.5, -0.15, 0), (0.5, 0.18, 1.9), "books"),
        ((-0.53, -0.12, 0), (-0.5, 0.18, 1.95), "wood-dark"),
        ((0.5, -0.12, 0), (0.53, 0.18, 1.95), "wood-dark"),
    ),
    "cabinet": (
        ((-0.45, -0.22, 0), (0.45, 0.22, 1.1), "drawers"),
        ((-0.15, -0.12, 1.1), (0.15, 0.12, 1.3), "crate"),
    ),
    "fridge": (((-0.3, -0.3, 0), (0.3, 0.3, 1.75), "fridge"),),
    "counter": (
        ((-0.9, -0.28, 0), (0.9, 0.28, 0.85), "drawers"),
        ((-0.92, -0.3, 0.85), (0.92, 0.3, 0.9), "metal"),
        ((0.3, -0.1, 0.9), (0.7, 0.25, 1.2), "screen"),
    ),
    "printer": (
        ((-0.3, -0.3, 0), (0.3, 0.3, 0.7), "metal"),
        ((-0.3, -0.3, 0.7), (0.3, 0.3, 1.0), "crate"),
    ),
    "plant": (
        ((-0.16, -0.16, 0), (0.16, 0.16, 0.35), "pot"),
        ((-0.03, -0.03, 0.35), (0.03, 0.03, 0.8), "wood-dark"),
        ((-0.25, -0.25, 0.7), (0.25, 0.25, 1.2), "leaves"),
        ((-0.15, -0.15, 1.2), (0.15, 0.15, 1.5), "leaves"),
    ),
    "crates": (
        ((-0.3, -0.3, 0), (0.3, 0.3, 0.5), "crate"),
        ((-0.2, -0.25, 0.5), (0.25, 0.2, 0.9), "crate"),
    ),
    "cooler": (
        ((-0.17, -0.17, 0), (0.17, 0.17, 0.9), "metal"),
        ((-0.13, -0.13, 0.9), (0.13, 0.13, 1.3), "water"),
    ),
}
"""Opposite corners and texture of each box."""
