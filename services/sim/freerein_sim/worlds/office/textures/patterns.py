"""Patterns of walls, floors and materials; each is drawn, and repeats without a seam."""

from collections.abc import Callable

import numpy as np

from freerein_sim.worlds.office.textures.painting import Pattern, axes, blank

DrawPattern = Callable[[np.random.Generator], Pattern]


def plain(rng: np.random.Generator) -> Pattern:
    """Returns no pattern."""
    return blank()


def stripes(rng: np.random.Generator) -> Pattern:
    """Returns vertical stripes."""
    width = int(rng.choice([4, 8, 16]))
    return np.asarray((axes()[1] // width) % 2, np.float64)


def bands(rng: np.random.Generator) -> Pattern:
    """Returns horizontal stripes."""
    width = int(rng.choice([4, 8]))
    return np.asarray((axes()[0] // width) % 2, np.float64)


def checks(rng: np.random.Generator) -> Pattern:
    """Returns a chess board."""
    rows, columns = axes()
    width = int(rng.choice([8, 16]))
    return np.asarray((rows // width + columns // width) % 2, np.float64)


def dots(rng: np.random.Generator) -> Pattern:
    """Returns dots in shifted rows."""
    rows, columns = axes()
    spacing = int(rng.choice([16, 32]))
    across = columns + spacing // 2 * ((rows // spacing) % 2)
    off = (rows % spacing - spacing / 2) ** 2 + (across % spacing - spacing / 2) ** 2
    return np.asarray(off < (spacing / 4) ** 2, np.float64)


def bricks(rng: np.random.Generator) -> Pattern:
    """Returns bricks."""
    rows, columns = axes()
    height = int(rng.choice([8, 16]))
    across = columns + height * ((rows // height) % 2)
    return np.asarray((rows % height < 2) | (across % (2 * height) < 2), np.float64)


def planks(rng: np.random.Generator) -> Pattern:
    """Returns planks."""
    shades = rng.random((8, 4)).repeat(8, axis=0).repeat(16, axis=1)
    shades[axes()[0] % 8 == 0] = 1
    return shades


def zigzag(rng: np.random.Generator) -> Pattern:
    """Returns a zigzag."""
    rows, columns = axes()
    return np.asarray(((rows + np.abs(columns % 32 - 16)) // 8) % 2, np.float64)


def panels(rng: np.random.Generator) -> Pattern:
    """Returns square panels."""
    rows, columns = axes()
    return np.asarray((rows % 32 < 2) | (columns % 32 < 2), np.float64)


def carpet(rng: np.random.Generator) -> Pattern:
    """Returns the flecks of a carpet."""
    return rng.random((16, 16)).repeat(4, axis=0).repeat(4, axis=1)


WALLS: tuple[DrawPattern, ...] = (plain, stripes, bricks, dots, zigzag, panels, bands)
FLOORS: tuple[DrawPattern, ...] = (carpet, checks, planks, bricks, stripes, panels)
