"""How much an answer is like those on held-out data: a score that falls where a model does not know what it sees.

Two things make an answer doubtful: frames unlike those of the fit (Mahalanobis distance, as Lee et al., "A simple
unified framework for detecting out-of-distribution samples", 2018, but of `image_statistics`), and little confidence
(Hendrycks and Gimpel, 2017). Both are ranked among held-out answers, so that the score needs no scale and no threshold
of its own: it is the share of held-out answers that were no less doubtful.

A few held-out trajectories do not tell how unsure a model is of others. Confidence does not count then, and a frame is
only doubtful far beyond the distances of the fit.
"""

import math

import torch
from torch import Tensor, nn

_QUANTILES = 1001
KNOWN_FRAMES = 2000
"""Frames of the fit from which a score is fitted, about."""

_RARE = 0.05
"""Share of held-out frames beyond whose distance the distance makes an answer doubtful."""

CALIBRATED_FROM = 20
"""Held-out trajectories from which on their answers tell how doubtful those on other trajectories are."""

_MARGIN = 2.0
"""With fewer, how many times as far as typical frames a frame may be. Where 4 to 40 trajectories of `grid` and `dial`
were fitted to, up to 21 % of others' frames were flagged at 1, and 1 % at 2; noise and stripes nearly always."""

_ANY_CONFIDENCE = 1e-6
"""Confidence that is enough where it does not count. A robot state unlike all others leaves none."""

_SHRINKAGE = 0.01
"""Share of the mean variance that is added to every direction, so that few frames give a usable covariance."""


class InDistribution(nn.Module):
    """Scores answers by the distance of their frames and by their confidence; it is fitted, not trained.

    Args:
        size: D, number of statistics of a frame; see `freerein.learning.image_statistics`.

    Until `fit` every score is 1.

    Attributes:
        held_out_trajectories: Those that `fit` was given; 0 before, and in a loaded model.
    """

    mean: Tensor
    whitening: Tensor
    distances: Tensor
    confidences: Tensor
    familiarities: Tensor

    def __init__(self, size: int) -> None:
        super().__init__()
        self.held_out_trajectories = 0
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("whitening", torch.zeros(size, size))
        for name in ("distances", "confidences", "familiarities"):
            self.register_buffer(name, torch.zeros(_QUANTILES))

    @torch.no_grad()
    def fit(self, known: Tensor, held_out: Tensor, confidence: Tensor, *, trajectories: int) -> None:
        """Sets what scores are relative to.

        Args:
            known: Statistics of frames that the network was fitted on, augmented as in the fit, float32 (M, D). Every
                other frame gives mean and covariance; the rest, and held-out ones, typical distances.
            held_out: Statistics of held-out frames, as they are, float32 (N, D).
            confidence: Confidence of k answers to each of these frames, float32 (N * k,), frame after frame; all 1 for
                a model without.
            trajectories: Held-out trajectories that these frames are from.
        """
        self.held_out_trajectories = trajectories
        self._fit_distance(known[::2])
        distances, rest = self.distance(held_out), known[1::2] if len(known) > 1 else known
        typical = _quantiles(torch.cat([_quantiles(self.distance(rest)), _quantiles(distances)]))
        if trajectories < CALIBRATED_FROM:
            typical = distances = _MARGIN * typical
            confidence = torch.full_like(typical, _ANY_CONFIDENCE)
        self.distances.copy_(typical)
        self.confidences.copy_(_quantiles(confidence))
        answers = distances.repeat_interleave(len(confidence) // len(distances))
        self.familiarities.copy_(_quantiles(self._familiarity(answers, confidence)))

    @property
    def warnings(self) -> tuple[str, ...]:
        """A sentence where few trajectories were held out in `fit`, else nothing."""
        if not 0 < self.held_out_trajectories < CALIBRATED_FROM:
            return ()
        return (
            f"`in_distribution` could not be calibrated: it takes {CALIBRATED_FROM} held-out trajectories, and there "
            f"were {self.held_out_trajectories}. It only tells frames that are far from those of the fit, not how "
            "unsure an answer is.",
        )

    def distance(self, statistics: Tensor) -> Tensor:
        """Returns the root mean square of whitened statistics, float32 (N,), of statistics (N, D); typically near 1."""
        distance: Tensor = ((statistics - self.mean) @ self.whitening).norm(dim=1)
        return distance

    def forward(self, distance: Tensor, confidence: Tensor) -> Tensor:
        """Returns scores in [0, 1], float32 (N,), of answers with some distances and confidences, float32 (N,) each."""
        return _share_up_to(self.familiarities, self._familiarity(distance, confidence))

    def _fit_distance(self, known: Tensor) -> None:
        self.mean.copy_(known.mean(dim=0))
        covariance = torch.cov(known.double().T, correction=0).reshape(len(self.mean), -1)
        ridge = _SHRINKAGE * covariance.diagonal().mean().clamp(min=1e-12)
        ridged = covariance + ridge * torch.eye(len(self.mean), dtype=torch.float64, device=covariance.device)
        self.whitening.copy_(torch.linalg.inv(torch.linalg.cholesky(ridged)).T / math.sqrt(len(self.mean)))

    def _familiarity(self, distance: Tensor, confidence: Tensor) -> Tensor:
        """Returns the smaller of two ranks, float32 (N,): of the confidence, and of a distance among the rare ones."""
        nearness = _share_up_to(-self.distances.flip(0), -distance) / _RARE
        return torch.minimum(nearness, _share_up_to(self.confidences, confidence))


def _quantiles(values: Tensor) -> Tensor:
    """Returns `_QUANTILES` evenly spaced quantiles of values (N,), ascending; without the limits of torch's own."""
    ordered = values.float().sort().values
    places = torch.linspace(0, len(ordered) - 1, _QUANTILES, device=values.device).round().long()
    return ordered[places]


def _share_up_to(quantiles: Tensor, values: Tensor) -> Tensor:
    """Returns the share of quantiles that are at most each value, float32 (N,)."""
    return torch.searchsorted(quantiles, values.float().contiguous(), right=True) / len(quantiles)
