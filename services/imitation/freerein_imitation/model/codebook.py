"""What is where in a frame, without a gradient: pixels are told by colour, and each colour says where it lies.

Cloning needs the place of things to about a pixel from few demonstrations. A convolution learns that slowly; a codebook
of colours, found by k-means on what differs from the still background, has it from the start, and frames that are
summarised once are cheap to learn from a hundred times.
"""

import torch
from torch import Tensor, nn

MOMENTS = 5
"""Numbers per colour: the root of its share of the frame, its mean column and row, and its spread along both."""

_NOISE = 24.0  # how far a pixel of the still background may be from its median, in levels of 255
_SOFTNESS = 400.0  # squared distance between colours at which one is e times less likely than the other
_MASS = 20.0  # pixels that count as one
_ABSENT = 0.5  # pixels of a colour below which its place is drawn towards the middle
_NOTHING = 1e-6
_SAMPLED_PIXELS = 20_000
_ITERATIONS = 25


class ColourCodebook(nn.Module):
    """Where each of some colours is: their share, mean place and spread over all pixels that are no background.

    Args:
        height: Of the frames, in pixels.
        width: In pixels.
        channels: 1 or 3.
        colours: How many there are.
    """

    background: Tensor
    colours: Tensor

    def __init__(self, *, height: int, width: int, channels: int, colours: int) -> None:
        super().__init__()
        self._size = height, width
        self.register_buffer("background", torch.empty(height * width, channels))
        self.register_buffer("colours", torch.empty(colours, channels))

    @torch.no_grad()
    def calibrate(self, frames: Tensor, *, generator: torch.Generator) -> None:
        """Takes the still background, a median, and the colours before it, by k-means, from training frames.

        Args:
            frames: uint8 (N, H, W, C).
            generator: On the CPU; draws the first colours and the pixels to look at.
        """
        pixels = frames.flatten(1, 2)  # (N, H * W, C)
        self.background.copy_(pixels.float().median(dim=0).values)
        before = pixels[self._differs(pixels)].float()  # (n, C)
        if not len(before):
            before = pixels[0].float()
        drawn = torch.randint(len(before), (_SAMPLED_PIXELS,), generator=generator)
        self.colours.copy_(_k_means(before[drawn], len(self.colours), generator))

    @torch.no_grad()
    def forward(self, frames: Tensor) -> Tensor:
        """Returns where each colour is in frames uint8 (N, H, W, C): float32 (N, colours, MOMENTS)."""
        pixels = frames.flatten(1, 2)  # (N, H * W, C)
        differs = self._differs(pixels)  # (N, H * W)
        place = differs.nonzero()[:, 1]  # (n,), frame after frame
        share = self._shares(pixels[differs].float(), self.background[place])  # (n, colours)
        powers = self._powers()[place]  # (n, MOMENTS)
        counts = differs.sum(dim=1).tolist()
        each = zip(torch.split(share, counts), torch.split(powers, counts), strict=True)
        return _moments(torch.stack([shares.T @ those for shares, those in each]))

    def _differs(self, pixels: Tensor) -> Tensor:
        """Returns which of the pixels (N, H * W, C) are no background, bool (N, H * W)."""
        return (pixels - self.background).abs().amax(dim=2) > _NOISE

    def _shares(self, pixels: Tensor, background: Tensor) -> Tensor:
        """Returns how much each pixel (n, C) is of each colour, (n, colours); what is left is background (n, C)."""
        near = (2 * pixels @ self.colours.T - self.colours.square().sum(dim=1)) / _SOFTNESS  # (n, colours)
        still = (2 * (pixels * background).sum(dim=1) - background.square().sum(dim=1)) / _SOFTNESS  # (n,)
        return torch.cat([near, still[:, None]], dim=1).softmax(dim=1)[:, :-1]

    def _powers(self) -> Tensor:
        """Returns 1, x, y, x^2 and y^2 of every place, x and y in [-1, 1]: (H * W, MOMENTS)."""
        y, x = (torch.linspace(-1, 1, side, device=self.colours.device) for side in self._size)
        columns, rows = x.repeat(len(y)), y.repeat_interleave(len(x))  # (H * W,) each
        return torch.stack([torch.ones_like(rows), columns, rows, columns.square(), rows.square()], dim=1)


def _moments(sums: Tensor) -> Tensor:
    """Returns mass, mean and spread of sums over pixels of 1, x, y, x^2 and y^2, float32 (N, colours, MOMENTS)."""
    mass = sums[..., :1]
    mean, square = (sums[..., 1:] / mass.clamp(min=_NOTHING)).chunk(2, dim=-1)  # (N, colours, 2) each
    variance = (square - mean.square()).clamp(min=0)
    is_there = mass / (mass + _ABSENT)
    return torch.cat([(mass / _MASS).sqrt(), is_there * mean, is_there * 2 * variance.sqrt()], dim=-1)


def _k_means(pixels: Tensor, count: int, generator: torch.Generator) -> Tensor:
    """Returns the centres of `count` clusters of pixels (n, C), the first ones drawn far apart (k-means++)."""
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


def moved(places: Tensor, columns: Tensor) -> Tensor:
    """Returns where the colours were if all but the background lay further to the right, float32 (N, ..., MOMENTS).

    Args:
        places: Where they are, float32 (N, ..., MOMENTS).
        columns: How much further, float32 (N,), in halves of the frame.
    """
    mass = _MASS * places[..., 0].square()
    further = columns.reshape(-1, *[1] * (mass.dim() - 1)) * mass / (mass + _ABSENT)
    return torch.cat([places[..., :1], places[..., 1:2] + further[..., None], places[..., 2:]], dim=-1)
