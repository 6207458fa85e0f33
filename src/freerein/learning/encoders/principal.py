"""A linear encoder that is fitted once and not trained: the first principal components of the frames of a fit."""

import torch
from torch import Tensor, nn
from torch.nn import functional

_SIDE = 56
_LEAST_VARIANCE = 1e-6  # share of the first component's


class PrincipalEncoder(nn.Module):
    """Projections of frames on their principal components, at about 56 pixels along the longer side or more.

    For a camera that does not move, before which a robot does: few numbers tell its whole pose, and nothing is trained.
    Objects that may be anywhere need another encoder. Features are scaled half of the way to equal variances; those
    beyond the rank of the frames are zeros. Frames are as in `PatchEncoder`.
    """

    mean: Tensor
    components: Tensor
    min_features = 1

    def __init__(self, *, height: int, width: int, channels: int, features: int) -> None:
        super().__init__()
        self._pool = max(1, max(height, width) // _SIDE)
        pixels = channels * -(-height // self._pool) * -(-width // self._pool)
        self.register_buffer("mean", torch.zeros(pixels))
        self.register_buffer("components", torch.zeros(features, pixels))

    @torch.no_grad()
    def fit_normalisation(self, frames: Tensor, *, generator: torch.Generator | None = None) -> None:
        """Sets mean and components from training frames, uint8 (N, H, W, C); nothing is drawn from the generator."""
        pixels = self._pixels(frames)
        self.mean.copy_(pixels.mean(dim=0))
        centred = pixels - self.mean  # (N, P)
        variances, vectors = torch.linalg.eigh((centred @ centred.T).double() / len(centred))  # ascending
        variances, vectors = variances.flip(0), vectors.flip(1)
        kept = variances[: len(self.components)]
        kept = kept[kept > _LEAST_VARIANCE * variances[0].clamp(min=1e-12)]
        directions = vectors[:, : len(kept)].T.float() @ centred  # (n, P)
        directions = functional.normalize(directions, dim=1) / (kept * kept[:1]).pow(0.25).float()[:, None]
        largest = directions.gather(1, directions.abs().argmax(dim=1, keepdim=True))
        self.components.zero_()
        self.components[: len(kept)] = directions * largest.sign()  # an eigenvector's sign is arbitrary

    def forward(self, frames: Tensor) -> Tensor:
        """Returns features, float32 (N, features), of frames uint8 (N, H, W, C)."""
        return (self._pixels(frames) - self.mean) @ self.components.T

    def _pixels(self, frames: Tensor) -> Tensor:
        """Returns the pixels of smaller frames, float32 (N, P)."""
        pixels = frames.permute(0, 3, 1, 2).float()
        return functional.avg_pool2d(pixels, self._pool, ceil_mode=True).flatten(1)
