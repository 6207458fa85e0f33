"""Any image as a network sees it."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import PIL.Image


@dataclass(frozen=True)
class Preprocess:
    """Resizes images, with antialiasing as CLIP does, and makes gray ones RGB.

    Attributes:
        side: Height and width of what comes out, in pixels.
    """

    side: int

    def __call__(self, image: npt.NDArray[np.uint8], /) -> npt.NDArray[np.uint8]:
        """Returns an image uint8 (h, w, 1 or 3), of any size, as uint8 (side, side, 3)."""
        if image.shape[:2] != (self.side, self.side):
            pixels = PIL.Image.fromarray(image[:, :, 0] if image.shape[2] == 1 else image)
            image = np.asarray(pixels.resize((self.side, self.side), PIL.Image.Resampling.BICUBIC))
        return np.ascontiguousarray(np.broadcast_to(image.reshape(self.side, self.side, -1), (self.side, self.side, 3)))
