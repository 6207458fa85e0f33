"""How a demonstration was followed, as pictures: a filmstrip, and an animation."""

from collections.abc import Sequence
from io import BytesIO

import numpy as np
import numpy.typing as npt
import PIL.Image

from freerein.cli.imitation.follow import Followed

Pixels = npt.NDArray[np.uint8]
"""uint8 (H, W, C)."""

_REACHED, _ABANDONED, _NOT_OVER, _GROUND = (46, 160, 67), (207, 34, 46), (175, 184, 193), (255, 255, 255)
_LEAST_PIXELS, _EDGE, _GAP, _COLUMNS = 96, 3, 4, 10
_FRAME_MS, _MOST_FRAMES = 100, 300


def fitted(pixels: Pixels, like: Pixels) -> Pixels:
    """Returns an image as high and wide as another."""
    if pixels.shape[:2] == like.shape[:2]:
        return pixels
    resized = PIL.Image.fromarray(pixels.squeeze()).resize((like.shape[1], like.shape[0]), PIL.Image.Resampling.BOX)
    return np.asarray(resized).reshape(*like.shape[:2], -1)


def filmstrip(followed: Followed, goals: Sequence[Pixels], camera: str) -> bytes:
    """Returns a PNG: each landmark, and below it what the robot saw when it was over, framed.

    Goals are as high and wide as the robot's frames. Green: the policy said that it was reached; red: abandoned; gray:
    not over.
    """
    tiles = []
    for index, goal in enumerate(goals):
        over = followed.landmarks[index] if index < len(followed.landmarks) else None
        seen = followed.seen[over.step].frames[camera] if over else np.full_like(goal, 255)
        tiles.append(np.concatenate([_framed(goal, _GROUND), _framed(seen, _colour(followed, index))]))
    rows = [tiles[first : first + _COLUMNS] for first in range(0, len(tiles), _COLUMNS)]
    blank = np.full_like(tiles[0], 255)
    strips = [np.concatenate([*row, *[blank] * (min(_COLUMNS, len(tiles)) - len(row))], axis=1) for row in rows]
    return _encoded(PIL.Image.fromarray(np.concatenate(strips)), "PNG")


def animation(followed: Followed, goals: Sequence[Pixels], camera: str) -> bytes:
    """Returns a GIF: the landmark that is pursued beside what the robot sees; below, landmarks as they are over."""
    every = -(-len(followed.seen) // _MOST_FRAMES)
    frames = []
    for step in range(0, len(followed.seen), every):
        over = sum(landmark.step <= step for landmark in followed.landmarks)
        goal, seen = goals[min(over, len(goals) - 1)], followed.seen[step].frames[camera]
        pair = np.concatenate([_framed(goal, _GROUND), _framed(seen, _GROUND)], axis=1)
        marks = _marks(followed, over, width=pair.shape[1])
        frames.append(PIL.Image.fromarray(np.concatenate([pair, marks])))
    made = BytesIO()
    frames[0].save(made, "GIF", save_all=True, append_images=frames[1:], duration=_FRAME_MS, loop=0)
    return made.getvalue()


def _marks(followed: Followed, over: int, *, width: int) -> Pixels:
    """Returns a bar with a part for each landmark, coloured where it is over."""
    bar = np.empty((2 * _GAP, width, 3), np.uint8)
    begins = np.linspace(0, width, followed.total + 1).astype(int)
    for index in range(followed.total):
        bar[:, begins[index] : begins[index + 1]] = _colour(followed, index) if index < over else _NOT_OVER
    return bar


def _colour(followed: Followed, index: int) -> tuple[int, int, int]:
    if index >= len(followed.landmarks):
        return _NOT_OVER
    return _REACHED if followed.landmarks[index].reached else _ABANDONED


def _framed(pixels: Pixels, edge: tuple[int, int, int]) -> Pixels:
    """Returns an image in colour, enlarged by whole pixels, with an edge and a gap around it."""
    scale = -(-_LEAST_PIXELS // max(pixels.shape[:2]))
    coloured = np.broadcast_to(pixels, (*pixels.shape[:2], 3)).repeat(scale, axis=0).repeat(scale, axis=1)
    inner = np.empty((coloured.shape[0] + 2 * _EDGE, coloured.shape[1] + 2 * _EDGE, 3), np.uint8)
    inner[:] = edge
    inner[_EDGE:-_EDGE, _EDGE:-_EDGE] = coloured
    return np.pad(inner, ((_GAP, _GAP), (_GAP, _GAP), (0, 0)), constant_values=255)


def _encoded(image: PIL.Image.Image, form: str) -> bytes:
    made = BytesIO()
    image.save(made, form)
    return made.getvalue()
