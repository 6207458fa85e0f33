"""Textures of a floor, drawn from its seed: patterns of two colours, and pictures."""

import colorsys
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

_SIZE_PX = 64
_GOLDEN = 0.618
_DADO_ROWS = 46
"""Rows of a wall's texture from which on its lower part has a colour of its own."""

Colour = npt.NDArray[np.float64]
"""float64 (3,), RGB in 0 to 1."""

Pattern = npt.NDArray[np.float64]
"""float64 (H, W), share of the second colour."""


Image = npt.NDArray[np.uint8]
"""uint8 (H, W, 3), RGB, its upper row first."""

DrawPattern = Callable[[np.random.Generator], Pattern]
DrawImage = Callable[[np.random.Generator], Image]


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
    textures = {"ceiling": Texture(_paint(rng, _panels(), _gray(0.86), _gray(0.75)), (1.0, 1.0))}
    hue, wall_order, floor_order = rng.random(), rng.permutation(len(_WALLS)), rng.permutation(len(_FLOORS))
    for number, room in enumerate(rooms):
        hue += _GOLDEN
        wall, floor = _WALLS[wall_order[number % len(_WALLS)]], _FLOORS[floor_order[number % len(_FLOORS)]]
        textures[f"wall-{room}"] = _wall(rng, wall(rng), hue)
        dark, light = _colour(hue + 0.45, 0.3, rng.uniform(0.3, 0.5)), _colour(hue + 0.4, 0.25, rng.uniform(0.5, 0.7))
        textures[f"floor-{room}"] = Texture(_paint(rng, floor(rng), dark, light), (1.0, 1.0))
    for name in sorted(set(names) - textures.keys()):
        textures[name] = _draw(rng, name)
    return textures


def _draw(rng: np.random.Generator, name: str) -> Texture:
    """Draws the texture of furniture, or of what hangs on a wall."""
    if name.startswith("poster"):
        return Texture(_poster(rng))
    if name in _PICTURES:
        return Texture(_PICTURES[name](rng))
    hues, saturation, value, pattern = _MATERIALS[name]
    hue = rng.uniform(*hues)
    first, second = _colour(hue, saturation, value), _colour(hue + 0.03, saturation, 0.75 * value)
    return Texture(_paint(rng, pattern(rng), first, second), (0.8, 0.8))


def _wall(rng: np.random.Generator, pattern: Pattern, hue: float) -> Texture:
    """Returns a tile as high as the wall; its lower part has another colour, or none of its own."""
    value = rng.uniform(0.65, 0.9)
    first, second = _colour(hue, 0.35, value), _colour(hue + 0.06, 0.45, 0.72 * value)
    pixels = _paint(rng, pattern, first, second)
    dado = np.full((_SIZE_PX - _DADO_ROWS, _SIZE_PX), 0.0)
    dado[:2] = 1
    if rng.random() < 0.7:
        lower = _colour(hue + rng.choice([0.3, 0.5]), 0.4, rng.uniform(0.35, 0.6))
        pixels[_DADO_ROWS:] = _paint(rng, dado, lower, _gray(0.9))
    return Texture(pixels, (1.25, 2.5))


def _paint(rng: np.random.Generator, pattern: Pattern, first: Colour, second: Colour) -> Image:
    """Returns two colours mixed by a pattern, with a fine and a coarse grain: uint8 (H, W, 3)."""
    height, width = pattern.shape
    grain = 0.03 * rng.standard_normal((height, width))
    coarse = 0.05 * rng.standard_normal((height // 4 + 1, width // 4))
    grain += coarse.repeat(4, axis=0)[:height].repeat(4, axis=1)
    colours = first + pattern[..., None] * (second - first)
    return _quantised(colours * (1 + grain[..., None]))


def _quantised(colours: npt.NDArray[np.float64]) -> Image:
    return np.clip(np.rint(255 * colours), 0, 255).astype(np.uint8)


def _colour(hue: float, saturation: float, value: float) -> Colour:
    return np.array(colorsys.hsv_to_rgb(hue % 1, saturation, value))


def _gray(level: float) -> Colour:
    return np.full(3, level)


def _blank() -> Pattern:
    return np.zeros((_SIZE_PX, _SIZE_PX))


def _axes() -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    rows, columns = np.mgrid[:_SIZE_PX, :_SIZE_PX]
    return rows, columns


def _plain(rng: np.random.Generator) -> Pattern:
    return _blank()


def _stripes(rng: np.random.Generator) -> Pattern:
    width = int(rng.choice([4, 8, 16]))
    return np.asarray((_axes()[1] // width) % 2, np.float64)


def _bands(rng: np.random.Generator) -> Pattern:
    width = int(rng.choice([4, 8]))
    return np.asarray((_axes()[0] // width) % 2, np.float64)


def _checks(rng: np.random.Generator) -> Pattern:
    rows, columns = _axes()
    width = int(rng.choice([8, 16]))
    return np.asarray((rows // width + columns // width) % 2, np.float64)


def _dots(rng: np.random.Generator) -> Pattern:
    rows, columns = _axes()
    spacing = int(rng.choice([16, 32]))
    across = columns + spacing // 2 * ((rows // spacing) % 2)
    off = (rows % spacing - spacing / 2) ** 2 + (across % spacing - spacing / 2) ** 2
    return np.asarray(off < (spacing / 4) ** 2, np.float64)


def _bricks(rng: np.random.Generator) -> Pattern:
    rows, columns = _axes()
    height = int(rng.choice([8, 16]))
    across = columns + height * ((rows // height) % 2)
    return np.asarray((rows % height < 2) | (across % (2 * height) < 2), np.float64)


def _planks(rng: np.random.Generator) -> Pattern:
    shades = rng.random((8, 4)).repeat(8, axis=0).repeat(16, axis=1)
    shades[_axes()[0] % 8 == 0] = 1
    return shades


def _zigzag(rng: np.random.Generator) -> Pattern:
    rows, columns = _axes()
    return np.asarray(((rows + np.abs(columns % 32 - 16)) // 8) % 2, np.float64)


def _panels(rng: np.random.Generator | None = None) -> Pattern:
    rows, columns = _axes()
    return np.asarray((rows % 32 < 2) | (columns % 32 < 2), np.float64)


def _carpet(rng: np.random.Generator) -> Pattern:
    return rng.random((16, 16)).repeat(4, axis=0).repeat(4, axis=1)


def _drawers(rng: np.random.Generator) -> Image:
    front = _blank()
    front[::16] = front[1::16] = 1
    front[8::16, 26:38] = 1
    hue = rng.uniform(0.02, 0.12)
    return _paint(rng, front, _colour(hue, 0.4, rng.uniform(0.45, 0.75)), _gray(0.15))


def _books(rng: np.random.Generator) -> Image:
    image = np.full((_SIZE_PX, _SIZE_PX, 3), 40, np.uint8)
    for shelf in range(4):
        column = 1
        while column < _SIZE_PX - 3:
            width, height = int(rng.integers(2, 6)), int(rng.integers(9, 14))
            colour = _colour(rng.random(), rng.uniform(0.3, 0.9), rng.uniform(0.4, 0.95))
            bottom = 16 * shelf + 15
            image[bottom - height : bottom, column : min(column + width, _SIZE_PX - 1)] = _quantised(colour)
            column += width
        image[16 * shelf + 15] = (150, 110, 70)
    return image


def _poster(rng: np.random.Generator) -> Image:
    hue = rng.random()
    image = np.tile(_colour(hue, 0.5, 0.9), (_SIZE_PX, _SIZE_PX, 1))
    rows, columns = _axes()
    for _ in range(3):
        colour = _colour(hue + rng.uniform(0.25, 0.75), 0.8, rng.uniform(0.3, 1))
        row, column = rng.integers(10, _SIZE_PX - 10, 2)
        size = rng.integers(8, 20)
        is_round = rng.random() < 0.5
        off = np.hypot(rows - row, columns - column) if is_round else np.maximum(abs(rows - row), abs(columns - column))
        image[off < size] = colour
    framed = _quantised(image)
    framed[:3] = framed[-3:] = framed[:, :3] = framed[:, -3:] = 30
    return framed


def _window(rng: np.random.Generator) -> Image:
    sky = np.linspace(0, 1, _SIZE_PX)[:, None, None]
    image = (1 - sky) * _colour(0.58, 0.45, 0.95) + sky * _colour(0.55, 0.1, 1.0) + np.zeros((1, _SIZE_PX, 1))
    horizon = int(rng.integers(34, 48))
    image[horizon:] = _colour(rng.uniform(0.2, 0.4), 0.5, 0.5)
    for _ in range(3):
        column, height = int(rng.integers(0, _SIZE_PX - 12)), int(rng.integers(6, 24))
        image[horizon - height : horizon + 6, column : column + 10] = _gray(rng.uniform(0.3, 0.7))
    image[:4] = image[-4:] = image[:, :4] = image[:, -4:] = image[:, 30:34] = _gray(0.95)
    return _quantised(image)


def _door(rng: np.random.Generator) -> Image:
    leaf = _blank()
    leaf[6:28, 12:52] = leaf[34:58, 12:52] = 0.6
    leaf[:2] = leaf[:, :3] = leaf[:, -3:] = 1
    hue, value = rng.uniform(0.0, 1.0), rng.uniform(0.35, 0.7)
    image = _paint(rng, leaf, _colour(hue, 0.5, value), _colour(hue, 0.5, 0.5 * value))
    image[30:34, 54:60] = (220, 200, 90)
    return image


def _whiteboard(rng: np.random.Generator) -> Image:
    image = np.full((_SIZE_PX, _SIZE_PX, 3), 240, np.uint8)
    for _ in range(7):
        row, column, length = int(rng.integers(6, 56)), int(rng.integers(6, 30)), int(rng.integers(10, 28))
        image[row : row + 3, column : column + length] = _quantised(_colour(rng.random(), 0.8, 0.6))
    image[:3] = image[-3:] = image[:, :3] = image[:, -3:] = 110
    return image


def _screen(rng: np.random.Generator) -> Image:
    image = np.tile(_colour(rng.random(), 0.6, 0.55), (_SIZE_PX, _SIZE_PX, 1))
    image[10:40, 8:34] = _colour(rng.random(), 0.2, 0.9)
    image[22:52, 30:56] = _colour(rng.random(), 0.5, 0.8)
    image[:4] = image[-4:] = image[:, :4] = image[:, -4:] = 0.06
    return _quantised(image)


def _fridge(rng: np.random.Generator) -> Image:
    front = _blank()
    front[22:24] = front[:2] = front[-2:] = 1
    front[8:18, 6:9] = front[28:44, 6:9] = 1
    return _paint(rng, front, _colour(rng.random(), 0.08, 0.9), _gray(0.3))


_WALLS: tuple[DrawPattern, ...] = (
    _plain,
    _stripes,
    _bricks,
    _dots,
    _zigzag,
    _panels,
    _bands,
)
_FLOORS: tuple[DrawPattern, ...] = (_carpet, _checks, _planks, _bricks, _stripes, _panels)
_PICTURES: dict[str, DrawImage] = {
    "books": _books,
    "door": _door,
    "drawers": _drawers,
    "fridge": _fridge,
    "screen": _screen,
    "whiteboard": _whiteboard,
    "window": _window,
}
_MATERIALS: dict[str, tuple[tuple[float, float], float, float, DrawPattern]] = {
    "crate": ((0.05, 0.15), 0.5, 0.75, _panels),
    "fabric": ((0.0, 1.0), 0.7, 0.7, _carpet),
    "fabric-dark": ((0.0, 1.0), 0.6, 0.4, _carpet),
    "leaves": ((0.25, 0.4), 0.7, 0.55, _carpet),
    "metal": ((0.5, 0.65), 0.08, 0.6, _plain),
    "pot": ((0.0, 0.1), 0.7, 0.6, _bands),
    "water": ((0.5, 0.6), 0.5, 0.85, _plain),
    "wood": ((0.05, 0.12), 0.5, 0.75, _planks),
    "wood-dark": ((0.02, 0.08), 0.55, 0.4, _planks),
}
"""Interval of hues, saturation, value and pattern."""
