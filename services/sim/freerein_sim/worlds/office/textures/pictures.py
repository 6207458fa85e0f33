"""Pictures that a face of a box shows once, such as a window or the front of a bookshelf."""

from collections.abc import Callable

import numpy as np

from freerein_sim.worlds.office.textures.painting import SIZE_PX, Image, axes, blank, colour, gray, paint, quantised

DrawImage = Callable[[np.random.Generator], Image]


def draw_poster(rng: np.random.Generator) -> Image:
    """Draws a poster; no two are alike."""
    hue = rng.random()
    image = np.tile(colour(hue, 0.5, 0.9), (SIZE_PX, SIZE_PX, 1))
    rows, columns = axes()
    for _ in range(3):
        shape = colour(hue + rng.uniform(0.25, 0.75), 0.8, rng.uniform(0.3, 1))
        row, column = rng.integers(10, SIZE_PX - 10, 2)
        size = rng.integers(8, 20)
        is_round = rng.random() < 0.5
        off = np.hypot(rows - row, columns - column) if is_round else np.maximum(abs(rows - row), abs(columns - column))
        image[off < size] = shape
    framed = quantised(image)
    framed[:3] = framed[-3:] = framed[:, :3] = framed[:, -3:] = 30
    return framed


def _drawers(rng: np.random.Generator) -> Image:
    front = blank()
    front[::16] = front[1::16] = 1
    front[8::16, 26:38] = 1
    hue = rng.uniform(0.02, 0.12)
    return paint(rng, front, colour(hue, 0.4, rng.uniform(0.45, 0.75)), gray(0.15))


def _books(rng: np.random.Generator) -> Image:
    image = np.full((SIZE_PX, SIZE_PX, 3), 40, np.uint8)
    for shelf in range(4):
        column = 1
        while column < SIZE_PX - 3:
            width, height = int(rng.integers(2, 6)), int(rng.integers(9, 14))
            spine = colour(rng.random(), rng.uniform(0.3, 0.9), rng.uniform(0.4, 0.95))
            bottom = 16 * shelf + 15
            image[bottom - height : bottom, column : min(column + width, SIZE_PX - 1)] = quantised(spine)
            column += width
        image[16 * shelf + 15] = (150, 110, 70)
    return image


def _window(rng: np.random.Generator) -> Image:
    sky = np.linspace(0, 1, SIZE_PX)[:, None, None]
    image = (1 - sky) * colour(0.58, 0.45, 0.95) + sky * colour(0.55, 0.1, 1.0) + np.zeros((1, SIZE_PX, 1))
    horizon = int(rng.integers(34, 48))
    image[horizon:] = colour(rng.uniform(0.2, 0.4), 0.5, 0.5)
    for _ in range(3):
        column, height = int(rng.integers(0, SIZE_PX - 12)), int(rng.integers(6, 24))
        image[horizon - height : horizon + 6, column : column + 10] = gray(rng.uniform(0.3, 0.7))
    image[:4] = image[-4:] = image[:, :4] = image[:, -4:] = image[:, 30:34] = gray(0.95)
    return quantised(image)


def _door(rng: np.random.Generator) -> Image:
    leaf = blank()
    leaf[6:28, 12:52] = leaf[34:58, 12:52] = 0.6
    leaf[:2] = leaf[:, :3] = leaf[:, -3:] = 1
    hue, value = rng.uniform(0.0, 1.0), rng.uniform(0.35, 0.7)
    image = paint(rng, leaf, colour(hue, 0.5, value), colour(hue, 0.5, 0.5 * value))
    image[30:34, 54:60] = (220, 200, 90)
    return image


def _whiteboard(rng: np.random.Generator) -> Image:
    image = np.full((SIZE_PX, SIZE_PX, 3), 240, np.uint8)
    for _ in range(7):
        row, column, length = int(rng.integers(6, 56)), int(rng.integers(6, 30)), int(rng.integers(10, 28))
        image[row : row + 3, column : column + length] = quantised(colour(rng.random(), 0.8, 0.6))
    image[:3] = image[-3:] = image[:, :3] = image[:, -3:] = 110
    return image


def _screen(rng: np.random.Generator) -> Image:
    image = np.tile(colour(rng.random(), 0.6, 0.55), (SIZE_PX, SIZE_PX, 1))
    image[10:40, 8:34] = colour(rng.random(), 0.2, 0.9)
    image[22:52, 30:56] = colour(rng.random(), 0.5, 0.8)
    image[:4] = image[-4:] = image[:, :4] = image[:, -4:] = 0.06
    return quantised(image)


def _fridge(rng: np.random.Generator) -> Image:
    front = blank()
    front[22:24] = front[:2] = front[-2:] = 1
    front[8:18, 6:9] = front[28:44, 6:9] = 1
    return paint(rng, front, colour(rng.random(), 0.08, 0.9), gray(0.3))


PICTURES: dict[str, DrawImage] = {
    "books": _books,
    "door": _door,
    "drawers": _drawers,
    "fridge": _fridge,
    "screen": _screen,
    "whiteboard": _whiteboard,
    "window": _window,
}
