"""The in-distribution score, where its value is known."""

import pytest
import torch

from freerein.learning.in_distribution import InDistribution
from freerein.types.segmentation import FLAGGED

HELD_OUT = 4000


def fitted(*, features: int = 3, seed: int = 0) -> tuple[InDistribution, torch.Tensor, torch.Tensor]:
    """Returns a score fitted on correlated features, and the held-out features and confidences."""
    generator = torch.Generator().manual_seed(seed)
    mixing = torch.randn(features, features, generator=generator)
    known, held_out = (torch.randn(HELD_OUT, features, generator=generator) @ mixing + 5 for _ in range(2))
    confidence = torch.rand(HELD_OUT, generator=generator)
    score = InDistribution(features)
    score.fit(known, held_out, confidence)
    return score, held_out, confidence


def test_scores_of_held_out_answers_are_evenly_spread() -> None:
    score, features, confidence = fitted()
    scores = score(score.distance(features), confidence).sort().values
    torch.testing.assert_close(scores, torch.linspace(0, 1, HELD_OUT), atol=5e-3, rtol=0)
    assert (scores < FLAGGED).float().mean() == pytest.approx(FLAGGED, abs=2e-3)


def test_what_is_far_from_all_known_features_is_flagged_however_sure() -> None:
    score, features, _ = fitted()
    far = features.mean(dim=0) + 10 * (features.max(dim=0).values - features.mean(dim=0))
    assert score(score.distance(far[None]), torch.ones(1)).item() == 0.0


def test_the_less_sure_of_two_equal_frames_scores_less() -> None:
    score, features, _ = fitted()
    typical = score.distance(features.mean(dim=0, keepdim=True).expand(3, -1))
    unsure, halfway, sure = score(typical, torch.tensor([0.001, 0.5, 0.999]))
    assert unsure < FLAGGED < halfway < sure


def test_distances_are_in_units_of_the_known_spread_in_every_direction() -> None:
    score, features, _ = fitted()
    assert score.distance(features).square().mean().item() == pytest.approx(1.0, abs=0.15)


def test_a_model_without_confidence_and_features_that_never_change_are_scored() -> None:
    score = InDistribution(2)
    score.fit(torch.ones(10, 2), torch.ones(5, 2), torch.ones(5))
    same, other = score(score.distance(torch.tensor([[1.0, 1.0], [1.0, 2.0]])), torch.ones(2))
    assert (same, other) == (1.0, 0.0)


def test_until_it_is_fitted_every_score_is_one() -> None:
    score = InDistribution(2)
    assert score(score.distance(torch.randn(4, 2)), torch.rand(4)).tolist() == [1.0] * 4
