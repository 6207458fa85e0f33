"""All textures of a floor."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from freerein_sim.worlds.office.textures import patterns
from freerein_sim.worlds.office.textures.painting import SIZE_PX, Image, Pattern, colour, gray, paint
from freerein_sim.worlds.office.textures.pictures import PICTURES, draw_poster

_GOLDEN = 0.618
_DADO_ROWS = 46
"""Rows of a wall's texture from which on its lower part has a colour of its own."""


@dataclass(frozen=True, eq=False)
class Texture:
    """A texture.

    Attributes:
        pixels: The image.
        tile_m: Width and height of a tile; None where a face shows it once, whatever the face's size.
    """

    pixels: Image
    tile_m: tuple[float, float] | None = None


def draw_textures(rng: np.random.Generator, rooms: Iterable[str], names: Iterable[str]) -> dict[str, Texture]:
    """Draws a floor's textures.

    Args:
        rng: The generator.
        rooms: Letters of the rooms; neighbours in this order differ most in hue.
        names: Names of the textures that are needed.
    """
    textures = {"ceiling": Texture(paint(rng, patterns.panels(rng), gray(0.86), gray(0.75)), (1.0, 1.0))}
    hue = rng.random()
    wall_order, floor_order = (rng.permutation(len(each)) for each in (patterns.WALLS, patterns.FLOORS))
    for number, room in enumerate(rooms):
        hue += _GOLDEN
        wall = patterns.WALLS[wall_order[number % len(wall_order)]]
        floor = patterns.FLOORS[floor_order[number % len(floor_order)]]
        textures[f"wall-{room}"] = _wall(rng, wall(rng), hue)
        dark, light = colour(hue + 0.45, 0.3, rng.uniform(0.3, 0.5)), colour(hue + 0.4, 0.25, rng.uniform(0.5, 0.7))
        textures[f"floor-{room}"] = Texture(paint(rng, floor(rng), dark, light), (1.0, 1.0))
    for name in sorted(set(names) - textures.keys()):
        textures[name] = _draw(rng, name)
    return textures


def _draw(rng: np.random.Generator, name: str) -> Texture:
    """Draws the texture of furniture, or of what hangs on a wall."""
    if name.startswith("poster"):
        return Texture(draw_poster(rng))
    if name in PICTURES:
        return Texture(PICTURES[name](rng))
    hues, saturation, value, pattern = _MATERIALS[name]
    hue = rng.uniform(*hues)
    first, second = colour(hue, saturation, value), colour(hue + 0.03, saturation, 0.75 * value)
    return Texture(paint(rng, pattern(rng), first, second), (0.8, 0.8))


def _wall(rng: np.random.Generator, pattern: Pattern, hue: float) -> Texture:
    """Returns a tile as high as the wall; its lower part has another colour, or none of its own."""
    value = rng.uniform(0.65, 0.9)
    first, second = colour(hue, 0.35, value), colour(hue + 0.06, 0.45, 0.72 * value)
    pixels = paint(rng, pattern, first, second)
    dado = np.full((SIZE_PX - _DADO_ROWS, SIZE_PX), 0.0)
    dado[:2] = 1
    if rng.random() < 0.7:
        lower = colour(hue + rng.choice([0.3, 0.5]), 0.4, rng.uniform(0.35, 0.6))
        pixels[_DADO_ROWS:] = paint(rng, dado, lower, gray(0.9))
    return Texture(pixels, (1.25, 2.5))


_MATERIALS: dict[str, tuple[tuple[float, float], float, float, patterns.DrawPattern]] = {
    "crate": ((0.05, 0.15), 0.5, 0.75, patterns.panels),
    "fabric": ((0.0, 1.0), 0.7, 0.7, patterns.carpet),
    "fabric-dark": ((0.0, 1.0), 0.6, 0.4, patterns.carpet),
    "leaves": ((0.25, 0.4), 0.7, 0.55, patterns.carpet),
    "metal": ((0.5, 0.65), 0.08, 0.6, patterns.plain),
    "pot": ((0.0, 0.1), 0.7, 0.6, patterns.bands),
    "water": ((0.5, 0.6), 0.5, 0.85, patterns.plain),
    "wood": ((0.05, 0.12), 0.5, 0.75, patterns.planks),
    "wood-dark": ((0.02, 0.08), 0.55, 0.4, patterns.planks),
}
"""Interval of hues, saturation, value and pattern."""
