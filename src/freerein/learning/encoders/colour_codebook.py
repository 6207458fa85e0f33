"""Where each colour is in a frame: a k-means codebook of foreground colours, and image moments of each.

Behavioural cloning needs the place of objects to about a pixel from few demonstrations. A convolution learns that
slowly; a colour codebook over a static background has it from the start, and each frame is encoded only once.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

MOMENTS = 5
"""Moments per colour: root of its mass, mean column and row, and standard deviation along both."""

_NOISE = 24.0  # largest difference of a background pixel from its median, in levels of 255
_TEMPERATURE = 400.0  # of the softmax over negative squared colour distances
_MASS_SCALE = 20.0  # pixels per unit of mass
_SHRINKAGE = 0.5  # pixels of a colour at which its mean is halfway between the frame's centre and where it is
_EPSILON = 1e-6
_SAMPLED_PIXELS = 20_000
_ITERATIONS = 25


class ColourCodebook(nn.Module):
    """Where each colour is: image moments of a k-means codebook of foreground colours; nothing is trained.

    Args:
        height: Frame height in pixels.
        width: Frame width in pixels.
        channels: 1 or 3.
        features: Number of features: `MOMENTS` for each of as many colours as fit, at least one, the rest zeros.
    """

    background: Tensor
    colours: Tensor
    is_trained = False
    has_colour_moments = True
    min_features = MOMENTS

    def __init__(self, *, height: int, width: int, channels: int, features: int) -> None:
        super().__init__()
        self._frame_size = height, width
        self._padding = features % MOMENTS
        self.register_buffer("background", torch.empty(height * width, channels))
        self.register_buffer("colours", torch.empty(features // MOMENTS, channels))

    @torch.no_grad()
    def fit_normalisation(self, frames: Tensor, *, generator: torch.Generator) -> None:
        """Sets the background, a median, and the colours before it, by k-means, from training frames.

        Args:
            frames: uint8 (N, H, W, C).
            generator: On the CPU; samples pixels and first centres.
        """
        pixels = frames.flatten(1, 2)  # (N, H * W, C)
        self.background.copy_(pixels.float().median(dim=0).values)
        foreground = pixels[self._is_foreground(pixels)].float()  # (n, C)
        if not len(foreground):
            foreground = pixels[0].float()
        sample = torch.randint(len(foreground), (_SAMPLED_PIXELS,), generator=generator)
        self.colours.copy_(_k_means(foreground[sample], len(self.colours), generator))

    @torch.no_grad()
    def forward(self, frames: Tensor) -> Tensor:
        """Returns the moments of each colour, float32 (N, features), in frames uint8 (N, H, W, C)."""
        pixels = frames.flatten(1, 2)  # (N, H * W, C)
        is_foreground = self._is_foreground(pixels)  # (N, H * W)
        position = is_foreground.nonzero()[:, 1]  # (n,), frame after frame
        assignment = self._assign(pixels[is_foreground].float(), self.background[position])  # (n, colours)
        powers = self._powers()[position]  # (n, MOMENTS)
        counts = is_foreground.sum(dim=1).tolist()
        per_frame = zip(torch.split(assignment, counts), torch.split(powers, counts), strict=True)
        moments = _moments(torch.stack([weights.T @ values for weights, values in per_frame]))  # (N, colours, MOMENTS)
        return functional.pad(moments.flatten(1), (0, self._padding))

    def _is_foreground(self, pixels: Tensor) -> Tensor:
        """Returns which of the pixels (N, H * W, C) differ from the background, bool (N, H * W)."""
        return (pixels - self.background).abs().amax(dim=2) > _NOISE

    def _assign(self, pixels: Tensor, background: Tensor) -> Tensor:
        """Returns soft assignments of pixels (n, C) to colours, (n, colours); the remainder is background (n, C)."""
        near = (2 * pixels @ self.colours.T - self.colours.square().sum(dim=1)) / _TEMPERATURE  # (n, colours)
        still = (2 * (pixels * background).sum(dim=1) - background.square().sum(dim=1)) / _TEMPERATURE  # (n,)
        return torch.cat([near, still[:, None]], dim=1).softmax(dim=1)[:, :-1]

    def _powers(self) -> Tensor:
        """Returns 1, x, y, x^2 and y^2 of every pixel, x and y in [-1, 1]: (H * W, MOMENTS)."""
        y, x = (torch.linspace(-1, 1, side, device=self.colours.device) for side in self._frame_size)
        columns, rows = x.repeat(len(y)), y.repeat_interleave(len(x))  # (H * W,) each
        return torch.stack([torch.ones_like(rows), columns, rows, columns.square(), rows.square()], dim=1)


def _moments(sums: Tensor) -> Tensor:
    """Returns mass, mean and deviation, float32 (N, colours, MOMENTS), of sums over 1, x, y, x^2 and y^2."""
    mass = sums[..., :1]
    mean, square = (sums[..., 1:] / mass.clamp(min=_EPSILON)).chunk(2, dim=-1)  # (N, colours, 2) each
    variance = (square - mean.square()).clamp(min=0)
    presence = mass / (mass + _SHRINKAGE)
    return torch.cat([(mass / _MASS_SCALE).sqrt(), presence * mean, presence * 2 * variance.sqrt()], dim=-1)


def _k_means(pixels: Tensor, count: int, generator: torch.Generator) -> Tensor:
    """Returns the centres of `count` clusters of pixels (n, C), initialised by k-means++."""
    centres = pixels[:1]
    for _ in range(count - 1):
        distance = torch.cdist(pixels, centres).amin(dim=1).square() + 1e-6  # (n,)
        chosen = torch.multinomial(distance, 1, generator=generator)
        centres = torch.cat([centres, pixels[chosen]])
    for _ in range(_ITERATIONS):
        nearest = torch.cdist(pixels, centres).argmin(dim=1)  # (n,)
        members = torch.zeros(count).index_add_(0, nearest, torch.ones(len(pixels)))
        sums = torch.zeros_like(centres).index_add_(0, nearest, pixels)
        centres = torch.where(members[:, None] > 0, sums / members.clamp(min=1)[:, None], centres)
    return centres


def shift_horizontally(moments: Tensor, shift: Tensor) -> Tensor:
    """Returns moments as if the foreground lay further to the right, float32 (N, ..., MOMENTS).

    Args:
        moments: float32 (N, ..., MOMENTS).
        shift: float32 (N,), in halves of the frame's width.
    """
    mass = _MASS_SCALE * moments[..., 0].square()
    columns = shift.reshape(-1, *[1] * (mass.dim() - 1)) * mass / (mass + _SHRINKAGE)
    return torch.cat([moments[..., :1], moments[..., 1:2] + columns[..., None], moments[..., 2:]], dim=-1)
