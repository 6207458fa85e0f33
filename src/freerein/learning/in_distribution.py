"""In-distribution score: the similarity of an answer to those on held-out data; it falls on unfamiliar inputs.

Two things make an answer doubtful: frames unlike those of the fit (Mahalanobis distance, as Lee et al., "A simple
unified framework for detecting out-of-distribution samples", 2018, but of `image_statistics`), and little confidence
(Hendrycks and Gimpel, 2017). Both are ranked among held-out answers, so that the score needs no scale and no threshold
of its own: it is the share of held-out answers that were no less doubtful.

A few held-out trajectories do not tell how unsure a model is of others. Confidence does not count then, and a frame is
only doubtful far beyond the distances of the fit. So it is where a fit saw augmented frames: what it learned holds for
some way beyond them.
"""

import math

import numpy as np
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

_AUGMENTED_MARGIN = 1.5
"""The same where a fit saw augmented frames. On `blocks`, a gamma of .6 costs nothing, and all is flagged at 1."""

_COMMON = 0.99
"""Share of typical frames of which the farthest gives the unit of the distances of a kind."""

_ANY_CONFIDENCE = 1e-6
"""Confidence that is enough where it does not count. A robot state unlike all others leaves none."""

_LEAST = 0.5 / _QUANTILES
"""Familiarity of a sure answer to a frame that is farther than all typical ones: less than a held-out answer's. Of an
answer that is less sure it is less, so that answers to such frames are ranked, too."""

_SHRINKAGE = 0.01
"""Share of the mean variance that is added to every direction, so that few frames give a usable covariance."""


class InDistribution(nn.Module):
    """Scores answers by the distance of their frames and by their confidence; it is fitted, not trained.

    Args:
        sizes: Numbers of a frame's statistics of each kind, with sum D; see `freerein.learning.image_statistics`. A
            frame is as far as its statistics of the kind in which it is farthest, relative to typical frames.

    Until `fit` every score is 1.

    Attributes:
        held_out_trajectories: Those that `fit` was given; 0 before, and in a loaded model.
    """

    mean: Tensor
    whitening: Tensor
    limits: Tensor
    distances: Tensor
    confidences: Tensor
    familiarities: Tensor

    def __init__(self, *sizes: int) -> None:
        super().__init__()
        self.held_out_trajectories = 0
        self._sizes = sizes
        self.register_buffer("mean", torch.zeros(sum(sizes)))
        self.register_buffer("whitening", torch.zeros(sum(sizes), sum(sizes)))
        if len(sizes) > 1:
            self.register_buffer("limits", torch.ones(len(sizes)))
        for name in ("distances", "confidences", "familiarities"):
            self.register_buffer(name, torch.zeros(_QUANTILES))

    @torch.no_grad()
    def fit(
        self, known: Tensor, held_out: Tensor, confidence: Tensor, *, trajectories: int, augmented: bool = False
    ) -> None:
        """Sets what scores are relative to.

        Args:
            known: Statistics of frames that the network was fitted on, augmented as in the fit, float32 (M, D). Every
                other frame gives mean and covariance; the rest, and held-out ones, typical distances.
            held_out: Statistics of held-out frames, as they are, float32 (N, D).
            confidence: Confidence of k answers to each of these frames, float32 (N * k,), frame after frame; all 1 for
                a model without.
            trajectories: Held-out trajectories that these frames are from.
            augmented: Whether the network was fitted to augmented frames.
        """
        self.held_out_trajectories = trajectories
        rest = known[1::2] if len(known) > 1 else known
        self._fit_distance(known[::2], torch.cat([rest, held_out]))
        distances = self.distance(held_out)
        typical = _quantiles(torch.cat([_quantiles(self.distance(rest)), _quantiles(distances)]))
        if augmented:
            typical = _AUGMENTED_MARGIN * typical
        if trajectories < CALIBRATED_FROM:
            typical = distances = typical if augmented else _MARGIN * typical
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
        """Returns how far frames are, float32 (N,), by their statistics (N, D).

        It is the root mean square of whitened statistics, typically near 1; where there are several kinds, the greatest
        of theirs, each in units of a distance that is rare in the fit.
        """
        distances = self._distances(statistics)  # (N, kinds)
        return distances[:, 0] if len(self._sizes) == 1 else (distances / self.limits).amax(dim=1)

    def forward(self, distance: Tensor, confidence: Tensor) -> Tensor:
        """Returns scores in [0, 1], float32 (N,), of answers with some distances and confidences, float32 (N,) each."""
        familiarity = self._familiarity(distance, confidence)
        share = _share_up_to(self.familiarities, familiarity)
        return torch.where(share > 0, share, familiarity / len(self.familiarities))

    def _distances(self, statistics: Tensor) -> Tensor:
        whitened = (statistics - self.mean) @ self.whitening
        return torch.stack([each.norm(dim=1) for each in torch.split(whitened, list(self._sizes), dim=1)], dim=1)

    def _fit_distance(self, known: Tensor, others: Tensor) -> None:
        """Sets mean, whitening and limits from statistics of frames, and of others, (N, D) each."""
        self.mean.copy_(known.mean(dim=0))
        for end, part in zip(
            np.cumsum(self._sizes).tolist(), torch.split(known, list(self._sizes), dim=1), strict=True
        ):
            at = slice(end - part.shape[1], end)
            self.whitening[at, at] = _whitening(part)
        if len(self._sizes) > 1:
            rare = [_quantiles(each)[round(_COMMON * _QUANTILES)] for each in self._distances(others).T]
            self.limits.copy_(torch.stack(rare).clamp(min=1e-6))

    def _familiarity(self, distance: Tensor, confidence: Tensor) -> Tensor:
        """Returns the smaller of two ranks, float32 (N,): of the confidence, and of a distance among the rare ones."""
        nearness, certainty = (
            _share_up_to(-self.distances.flip(0), -distance),
            _share_up_to(self.confidences, confidence),
        )
        return torch.where(nearness > 0, torch.minimum(nearness / _RARE, certainty), _LEAST * certainty)


def _whitening(known: Tensor) -> Tensor:
    """Returns the whitening matrix of statistics (N, D) minus their mean: float64 (D, D)."""
    covariance = torch.cov(known.double().T, correction=0).reshape(known.shape[1], -1)
    ridge = _SHRINKAGE * covariance.diagonal().mean().clamp(min=1e-12)
    ridged = covariance + ridge * torch.eye(len(covariance), dtype=torch.float64, device=covariance.device)
    whitening: Tensor = torch.linalg.inv(torch.linalg.cholesky(ridged)).T / math.sqrt(len(covariance))
    return whitening


def _quantiles(values: Tensor) -> Tensor:
    """Returns `_QUANTILES` evenly spaced quantiles of values (N,), ascending; without the limits of torch's own."""
    ordered = values.float().sort().values
    places = torch.linspace(0, len(ordered) - 1, _QUANTILES, device=values.device).round().long()
    return ordered[places]


def _share_up_to(quantiles: Tensor, values: Tensor) -> Tensor:
    """Returns the share of quantiles that are at most each value, float32 (N,)."""
    return torch.searchsorted(quantiles, values.float().contiguous(), right=True) / len(quantiles)
