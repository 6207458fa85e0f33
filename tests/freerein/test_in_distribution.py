"""The in-distribution score, where its value is known."""

import pytest
import torch

from freerein.learning.in_distribution import CALIBRATED_FROM, InDistribution
from freerein.types.segmentation import FLAGGED

HELD_OUT = 4000


def fitted(*, features: int = 3, seed: int = 0) -> tuple[InDistribution, torch.Tensor, torch.Tensor]:
    """Returns a score fitted on correlated features, and the held-out features and confidences."""
    generator = torch.Generator().manual_seed(seed)
    mixing = torch.randn(features, features, generator=generator)
    known, held_out = (torch.randn(HELD_OUT, features, generator=generator) @ mixing + 5 for _ in range(2))
    confidence = torch.rand(HELD_OUT, generator=generator)
    score = InDistribution(features)
    score.fit(known, held_out, confidence, trajectories=100)
    return score, held_out, confidence


def test_scores_of_held_out_answers_are_evenly_spread() -> None:
    score, features, confidence = fitted()
    scores = score(score.distance(features), confidence).sort().values
    torch.testing.assert_close(scores, torch.linspace(0, 1, HELD_OUT), atol=5e-3, rtol=0)
    assert (scores < FLAGGED).float().mean() == pytest.approx(FLAGGED, abs=2e-3)


def test_what_is_far_from_all_known_features_is_flagged_however_sure() -> None:
    score, features, _ = fitted()
    far = features.mean(dim=0) + 10 * (features.max(dim=0).values - features.mean(dim=0))
    unsure, sure = score(score.distance(far[None]).expand(2), torch.tensor([0.5, 1.0]))
    assert unsure < sure < 1e-5


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
    score.fit(torch.ones(10, 2), torch.ones(5, 2), torch.ones(5), trajectories=1)
    same, other = score(score.distance(torch.tensor([[1.0, 1.0], [1.0, 2.0]])), torch.ones(2))
    assert same == 1.0
    assert other < 1e-5


@pytest.mark.parametrize("kinds", [(2,), (1, 1)])
def test_until_it_is_fitted_every_score_is_one(kinds: tuple[int, ...]) -> None:
    score = InDistribution(*kinds)
    assert score(score.distance(torch.randn(4, 2)), torch.rand(4)).tolist() == [1.0] * 4


def test_a_frame_is_as_far_as_the_few_statistics_of_one_kind_among_many_of_another() -> None:
    generator = torch.Generator().manual_seed(0)
    known, held_out = (torch.randn(HELD_OUT, 102, generator=generator) for _ in range(2))
    frame = torch.zeros(1, 102)
    frame[0, 100:] = 12.0
    told = {}
    for kinds in ((102,), (100, 2)):
        score = InDistribution(*kinds)
        score.fit(known, held_out, torch.rand(HELD_OUT, generator=generator), trajectories=100, augmented=True)
        told[kinds] = score(score.distance(frame), torch.ones(1)).item()
    assert told[100, 2] < FLAGGED < told[(102,)]


def test_fits_to_augmented_frames_allow_half_as_much_distance_again() -> None:
    _, features, confidence = fitted()
    for augmented, farthest in ((False, 1.0), (True, 1.5)):
        score = InDistribution(3)
        score.fit(features, features, confidence, trajectories=100, augmented=augmented)
        direction = torch.ones(1, 3)
        reach = score.distance(features).max() / score.distance(features.mean(dim=0) + direction)
        for times, flagged in ((0.7 * farthest, False), (1.1 * farthest, True)):
            far = features.mean(dim=0) + times * reach * direction
            assert bool(score(score.distance(far), torch.ones(1)) < FLAGGED) == flagged


def of_trajectories(count: int, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
    """Returns features and confidences of trajectories of 30 frames: most of what differs, differs between them."""
    places, certainty = torch.randn(count, 1, 8, generator=generator), torch.rand(count, 1, generator=generator)
    features = places + 0.3 * torch.randn(count, 30, 8, generator=generator)
    confidence = (certainty + 0.1 * torch.rand(count, 30, generator=generator)).clamp(max=1)
    return features.flatten(0, 1), confidence.flatten()


@pytest.mark.parametrize("held_out", [1, 2, 4, 10, 20, 40])
def test_at_most_a_twentieth_of_frames_like_those_held_out_is_flagged_however_few_they_are(held_out: int) -> None:
    flagged, generator = [], torch.Generator().manual_seed(held_out)
    for _ in range(40):
        known, _ = of_trajectories(10 * held_out, generator)
        score = InDistribution(8)
        score.fit(known, *of_trajectories(held_out, generator), trajectories=held_out)
        features, confidence = of_trajectories(50, generator)
        flagged.append((score(score.distance(features), confidence) < FLAGGED).float().mean())
        assert score(score.distance(100 * features), confidence).max() < FLAGGED
    assert torch.stack(flagged).mean() <= 0.05


def test_a_score_of_few_held_out_trajectories_says_that_it_is_not_calibrated() -> None:
    generator = torch.Generator().manual_seed(0)
    told = []
    for held_out in (1, CALIBRATED_FROM - 1, CALIBRATED_FROM):
        score = InDistribution(8)
        score.fit(of_trajectories(20, generator)[0], *of_trajectories(held_out, generator), trajectories=held_out)
        told.append(score.warnings)
    assert "20 held-out trajectories, and there were 1." in told[0][0]
    assert [len(each) for each in told] == [1, 1, 0]
    assert InDistribution(8).warnings == ()
