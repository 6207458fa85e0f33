"""Synthetic images of single objects with captions, from which the grounding model learns nouns.

At most one object on a dull background with gray clutter; no scene of a task. Captions mention no positions: the model
learns the "what" of section 4.2, not the "where".
"""

import colorsys
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import numpy.typing as npt
import PIL.Image
import PIL.ImageDraw

from freerein.goal_text import SYNONYMS

IMAGE_SIZE = 64
NOTHING = "nothing"
_EMPTY_PROBABILITY = 0.1
_OVERSAMPLING = 2
_RADIUS = (0.04, 0.2)
_SMALL_BELOW, _BIG_ABOVE = 0.07, 0.12
_MAX_CLUTTER = 7

Colour = tuple[int, int, int]
Pen = PIL.ImageDraw.ImageDraw
Rng = np.random.Generator
Point = tuple[float, float]

_HUES: Mapping[str, tuple[Point, Point, Point]] = MappingProxyType(
    {
        "red": ((-8, 8), (0.75, 1.0), (0.55, 1.0)),
        "orange": ((22, 34), (0.8, 1.0), (0.85, 1.0)),
        "yellow": ((44, 58), (0.75, 1.0), (0.7, 1.0)),
        "green": ((95, 145), (0.6, 1.0), (0.4, 0.95)),
        "cyan": ((172, 190), (0.6, 1.0), (0.6, 1.0)),
        "blue": ((212, 245), (0.65, 1.0), (0.5, 1.0)),
        "purple": ((262, 285), (0.5, 0.9), (0.4, 0.9)),
        "magenta": ((300, 318), (0.7, 1.0), (0.65, 1.0)),
        "pink": ((335, 350), (0.3, 0.5), (0.9, 1.0)),
        "brown": ((18, 32), (0.55, 0.85), (0.3, 0.5)),
    }
)
"""Ranges of hue in degrees, saturation and value, by colour."""

COLOURS = tuple(_HUES)


@dataclass(frozen=True)
class Attributes:
    """Attributes of an object, or those that a caption mentions; None for unmentioned ones, and for a middle size."""

    colour: str | None = None
    shape: str | None = None
    size: str | None = None

    def describes(self, other: "Attributes") -> bool:
        """Returns whether all attributes mentioned here are those of the other."""
        ours, theirs = (self.colour, self.shape, self.size), (other.colour, other.shape, other.size)
        return all(own is None or own == other for own, other in zip(ours, theirs, strict=True))


def render(rng: Rng) -> tuple[npt.NDArray[np.uint8], Attributes | None]:
    """Returns a picture, uint8 (64, 64, 3), and the object that it shows; None for none."""
    scale = _OVERSAMPLING if rng.random() < 0.5 else 1  # 1: hard edges, as simulators render
    side = IMAGE_SIZE * scale
    canvas = PIL.Image.fromarray(_background(side, rng))
    pen = PIL.ImageDraw.Draw(canvas)
    for _ in range(rng.integers(_MAX_CLUTTER)):
        _clutter(pen, side, rng)
    shown = None if rng.random() < _EMPTY_PROBABILITY else _object(pen, side, rng)
    if rng.random() < 0.5:
        _clutter(pen, side, rng, thin=True)  # may occlude the object
    pixels = np.asarray(canvas.reduce(scale) if scale > 1 else canvas).astype(np.int16)
    noise = rng.integers(-3, 4, size=pixels.shape, dtype=np.int16)
    return np.clip(pixels + noise, 0, 255).astype(np.uint8), shown


def caption(shown: Attributes | None, rng: Rng) -> tuple[str, Attributes | None]:
    """Returns a true caption of an object, and the attributes that it mentions."""
    if shown is None:
        return NOTHING, None
    said = Attributes(
        colour=shown.colour if rng.random() < 0.9 else None,
        shape=shown.shape if rng.random() < 0.8 else None,
        size=shown.size if rng.random() < 0.3 else None,
    )
    names = NAMES[said.shape] if said.shape else ("object", "thing")
    words = [word for word in (said.size, said.colour, names[rng.integers(len(names))]) if word]
    return " ".join(("an" if words[0][0] in "aeiou" else "a", *words)), said


def names(shown: Attributes | None) -> tuple[str, ...]:
    """Returns the words of the vocabulary that name an object by its colour, shape or size; none for no object."""
    if shown is None:
        return ()
    shapes = NAMES[shown.shape] if shown.shape else ()
    return tuple(word for word in (shown.colour, *shapes, shown.size) if word)


def _background(side: int, rng: Rng) -> npt.NDArray[np.uint8]:
    """Returns a gradient of dull colours, often in two parts."""
    top, bottom = (np.array(_dull(rng)) for _ in range(2))
    at = np.linspace(0, 1, side)[:, None, None]
    picture = np.broadcast_to(top + (bottom - top) * at * rng.uniform(0, 0.5), (side, side, 3)).copy()
    if rng.random() < 0.5:
        picture[int(rng.uniform(0.2, 0.9) * side) :] = bottom
    if rng.random() < 0.3:
        picture = picture.transpose(1, 0, 2)
    return np.ascontiguousarray(np.clip(picture, 0, 255), dtype=np.uint8)


def _dull(rng: Rng) -> Colour:
    return _hsv(rng.uniform(0, 360), rng.uniform(0, 0.25) * rng.random(), rng.uniform(0.02, 1.0))


def _hsv(hue: float, saturation: float, value: float) -> Colour:
    red, green, blue = (round(255 * part) for part in colorsys.hsv_to_rgb(hue / 360 % 1, saturation, value))
    return red, green, blue


def _shade(colour: Colour, factor: float) -> Colour:
    red, green, blue = (min(255, round(factor * part)) for part in colour)
    return red, green, blue


def _clutter(pen: Pen, side: int, rng: Rng, *, thin: bool = False) -> None:
    width, height = rng.uniform(0.02, 0.06 if thin else 0.5, size=2) * side
    if thin and rng.random() < 0.8:
        height *= 6
    x, y = rng.uniform(-0.1, 1.0, size=2) * side
    box, colour = (x, y, x + width, y + height), _dull(rng)
    if rng.random() < 0.7:
        pen.rectangle(box, fill=colour)
    else:
        pen.ellipse(box, fill=colour)


def _object(pen: Pen, side: int, rng: Rng) -> Attributes:
    name = COLOURS[rng.integers(len(COLOURS))]
    shape = SHAPES[rng.integers(len(SHAPES))]
    radius = float(np.exp(rng.uniform(*np.log(_RADIUS))))
    x, y = rng.uniform(0.03, 0.97, size=2) * side
    colour = _hsv(*(rng.uniform(*span) for span in _HUES[name]))
    _DRAWINGS[shape](pen, x, y, radius * side, colour, rng=rng)
    size = "small" if radius < _SMALL_BELOW else "big" if radius > _BIG_ABOVE else None
    return Attributes(name, shape, size)


def _block(pen: Pen, x: float, y: float, radius: float, colour: Colour, *, rng: Rng) -> None:
    """Draws a box in perspective, or a rotated square."""
    dx, dy = rng.uniform(-0.7, 0.7) * radius, -rng.uniform(0, 0.7) * radius
    left, right, up, down = x - radius, x + radius, y - radius, y + radius
    if rng.random() < 0.6:
        edge = right if dx > 0 else left
        top = _shade(colour, rng.uniform(0.9, 1.15))
        flank = _shade(colour, rng.uniform(0.65, 1.0))
        pen.polygon([(left, up), (right, up), (right + dx, up + dy), (left + dx, up + dy)], fill=top)
        pen.polygon([(edge, up), (edge, down), (edge + dx, down + dy), (edge + dx, up + dy)], fill=flank)
        pen.rectangle((left, up, right, down), fill=colour)
    else:
        pen.polygon(_corners(x, y, radius * math.sqrt(2), 4, turn=math.pi / 4 + rng.normal(0, 0.15)), fill=colour)


def _ball(pen: Pen, x: float, y: float, radius: float, colour: Colour, *, rng: Rng) -> None:
    dark, offset = rng.uniform(0.7, 1.0), rng.uniform(-0.3, 0.3, size=2) * radius
    pen.ellipse((x - radius, y - radius, x + radius, y + radius), fill=_shade(colour, dark))
    inner = 0.65 * radius
    ix, iy = x + offset[0], y + offset[1]
    pen.ellipse((ix - inner, iy - inner, ix + inner, iy + inner), fill=colour)


def _cylinder(pen: Pen, x: float, y: float, radius: float, colour: Colour, *, rng: Rng) -> None:
    half, lid = 0.7 * radius, 0.3 * radius
    pen.rectangle((x - half, y - radius, x + half, y + radius), fill=colour)
    pen.ellipse((x - half, y + radius - lid, x + half, y + radius + lid), fill=colour)
    lid_colour = _shade(colour, rng.uniform(0.7, 1.15))
    pen.ellipse((x - half, y - radius - lid, x + half, y - radius + lid), fill=lid_colour)


def _cone(pen: Pen, x: float, y: float, radius: float, colour: Colour, *, rng: Rng) -> None:
    lid = 0.3 * radius
    pen.ellipse((x - radius, y + radius - lid, x + radius, y + radius + lid), fill=_shade(colour, rng.uniform(0.8, 1)))
    pen.polygon([(x - radius, y + radius), (x, y - radius), (x + radius, y + radius)], fill=colour)


def _ring(pen: Pen, x: float, y: float, radius: float, colour: Colour, *, rng: Rng) -> None:
    width = max(1, round(rng.uniform(0.3, 0.5) * radius))
    flat = rng.uniform(0.7, 1.0) * radius
    pen.ellipse((x - radius, y - flat, x + radius, y + flat), outline=colour, width=width)


def _star(pen: Pen, x: float, y: float, radius: float, colour: Colour, *, rng: Rng) -> None:
    turn = rng.uniform(0, 2 * math.pi)
    outer = _corners(x, y, 1.2 * radius, 5, turn=turn)
    inner = _corners(x, y, 0.5 * radius, 5, turn=turn + math.pi / 5)
    pen.polygon([point for pair in zip(outer, inner, strict=True) for point in pair], fill=colour)


def _cross(pen: Pen, x: float, y: float, radius: float, colour: Colour, *, rng: Rng) -> None:
    half = rng.uniform(0.25, 0.4) * radius
    pen.rectangle((x - radius, y - half, x + radius, y + half), fill=colour)
    pen.rectangle((x - half, y - radius, x + half, y + radius), fill=colour)


def _pyramid(pen: Pen, x: float, y: float, radius: float, colour: Colour, *, rng: Rng) -> None:
    ridge = x + rng.uniform(-0.4, 0.4) * radius
    flank = _shade(colour, rng.uniform(0.65, 0.9))
    pen.polygon([(x - radius, y + radius), (x, y - radius), (x + radius, y + radius)], fill=flank)
    pen.polygon([(x - radius, y + radius), (x, y - radius), (ridge, y + radius)], fill=colour)


def _corners(x: float, y: float, radius: float, count: int, *, turn: float) -> list[Point]:
    angles = (turn + 2 * math.pi * corner / count for corner in range(count))
    return [(x + radius * math.cos(angle), y + radius * math.sin(angle)) for angle in angles]


_DRAWINGS: Mapping[str, Callable[..., None]] = MappingProxyType(
    {
        "block": _block,
        "ball": _ball,
        "cylinder": _cylinder,
        "cone": _cone,
        "ring": _ring,
        "star": _star,
        "cross": _cross,
        "pyramid": _pyramid,
    }
)
SHAPES = tuple(_DRAWINGS)
NAMES = MappingProxyType({shape: (shape, *SYNONYMS.get(shape, ())) for shape in SHAPES})
"""Words for each shape."""

VOCABULARY = (
    "a",
    "an",
    "small",
    "big",
    *COLOURS,
    *(name for shape in SHAPES for name in NAMES[shape]),
    "object",
    "thing",
    NOTHING,
)
