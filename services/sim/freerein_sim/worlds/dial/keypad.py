"""The keypad: where its keys are, when one is pressed, and what their faces look like. No simulator.

The keys are laid out as on a telephone, 1 2 3 in the row next to the arm and 0 below 8, as the camera sees them. x
points from the arm to the camera, y to the camera's right, z up, in metres.
"""

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont

DIGITS = tuple(range(10))
PITCH_M = 0.12
KEY_HALF_M = (0.05, 0.05, 0.015)
TOP_M = 0.06
"""Height of the tops of keys that are up."""

TRAVEL_M = 0.015
PRESSED_M = 0.008
"""How far a key must be pushed down to count as pressed."""

_CENTRE_X_M = 0.5
_FACE_PX, _FONT_PX = 64, 62
_INK, _PLASTIC = 20, 235


def centre(digit: int) -> tuple[float, float]:
    """Returns where the centre of a digit's key is, x and y."""
    row, column = divmod(digit - 1, 3) if digit else (3, 1)
    return _CENTRE_X_M + (row - 1.5) * PITCH_M, (column - 1) * PITCH_M


CENTRES_M = np.array([centre(digit) for digit in DIGITS])
"""float64 (10, 2): x and y of each key's centre, by digit."""


def face(digit: int) -> npt.NDArray[np.uint8]:
    """Returns the image on top of a digit's key, uint8 (64, 64, 3), in the font that ships with pillow."""
    image = Image.new("L", (_FACE_PX, _FACE_PX), _PLASTIC)
    middle = (_FACE_PX / 2, _FACE_PX / 2)
    ImageDraw.Draw(image).text(middle, str(digit), fill=_INK, anchor="mm", font=ImageFont.load_default(_FONT_PX))
    return np.repeat(np.asarray(image)[:, :, None], 3, axis=2)
