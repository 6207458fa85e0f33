import itertools
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from freerein_segmentation.core import decoding
from freerein_segmentation.core.decoding import Decoded, merge_short, smooth

Probabilities = npt.NDArray[np.float32]
SKILLS = "abcde"


def certain(labels: list[int], *, skills: int = 3, confidence: float = 0.8) -> Probabilities:
    rest = (1 - confidence) / (skills - 1)
    return np.where(np.eye(skills, dtype=bool)[labels], confidence, rest).astype(np.float32)


def decode(given: Probabilities, **options: Any) -> Decoded:
    given_none = {"smoothing": 0.0, "min_segment": 0, "min_confidence": 0.0, "min_kept": 0}
    return decoding.decode(given, skills=SKILLS, **(given_none | options))


@st.composite
def probabilities(draw: st.DrawFn) -> Probabilities:
    seed, timesteps, skills = draw(st.tuples(st.integers(0, 10_000), st.integers(1, 60), st.integers(1, 5)))
    return np.random.default_rng(seed).dirichlet(np.ones(skills), timesteps).astype(np.float32)


def test_without_smoothing_and_merging_labels_are_the_likeliest_skills() -> None:
    decoded = decode(certain([0, 0, 2, 1, 1]), smoothing=0.0, min_segment=0)
    assert decoded.labels.tolist() == [0, 0, 2, 1, 1]
    assert decoded.labels.dtype == np.int64
    assert decoded.confidence.dtype == np.float32
    assert decoded.confidence.tolist() == pytest.approx([0.8] * 5)
    assert [(segment.start, segment.end, segment.skill) for segment in decoded.segments] == [
        (0, 2, "a"),
        (2, 3, "c"),
        (3, 5, "b"),
    ]


def test_a_short_segment_goes_to_the_neighbour_that_its_timesteps_like_better() -> None:
    flicker = certain([0, 0, 0, 2, 2, 1, 1, 1])
    flicker[3:5] = [0.1, 0.3, 0.6]
    decoded = decode(flicker, smoothing=0.0, min_segment=3)
    assert decoded.labels.tolist() == [0, 0, 0, 1, 1, 1, 1, 1]
    assert decoded.confidence[3] == pytest.approx(0.3)
    assert decoded.segments[1].confidence == pytest.approx((0.3 * 2 + 0.8 * 3) / 5)


def test_a_flicker_inside_a_segment_joins_its_two_halves() -> None:
    labels = np.array([0, 0, 1, 0, 0])
    assert merge_short(labels, certain(labels.tolist()), min_segment=3).tolist() == [0] * 5


def test_a_trajectory_shorter_than_a_segment_becomes_one_segment() -> None:
    decoded = decode(certain([0, 1, 1]), smoothing=0.0, min_segment=100)
    assert [(segment.start, segment.end) for segment in decoded.segments] == [(0, 3)]


def test_smoothing_removes_a_flicker_and_keeps_the_boundary() -> None:
    decoded = decode(certain([0] * 10 + [1] + [0] * 9 + [2] * 20), smoothing=1.5, min_segment=0)
    assert decoded.labels.tolist() == [0] * 20 + [2] * 20


def test_smoothing_leaves_what_is_constant_alone_up_to_the_ends() -> None:
    np.testing.assert_allclose(smooth(certain([1] * 7), sigma=3.0), certain([1] * 7), atol=1e-6)


def test_smoothing_is_gaussian() -> None:
    impulse = certain([0] * 30 + [1] + [0] * 30, skills=2, confidence=1.0)
    smoothed = smooth(impulse, sigma=2.0)[:, 1]
    assert smoothed[32] / smoothed[30] == pytest.approx(np.exp(-0.5))
    assert smoothed[34] / smoothed[30] == pytest.approx(np.exp(-2.0))


@given(probabilities(), st.floats(0.0, 100.0), st.integers(0, 20))
def test_segments_cover_the_trajectory_and_none_is_short(given_: Probabilities, sigma: float, least: int) -> None:
    decoded = decode(given_, smoothing=sigma, min_segment=least)
    segments = decoded.segments
    assert [0, *(segment.end for segment in segments)] == [*(segment.start for segment in segments), len(given_)]
    assert all(first.skill != second.skill for first, second in itertools.pairwise(segments))
    assert all(segment.end - segment.start >= min(least, len(given_)) for segment in segments) or len(segments) == 1
    assert [SKILLS[label] for label in decoded.labels] == [
        segment.skill for segment in segments for _ in range(segment.start, segment.end)
    ]
    assert ((decoded.confidence >= 0) & (decoded.confidence <= 1)).all()


def test_short_segments_are_rejected_after_merging() -> None:
    flicker = certain([0] * 4 + [1] * 2 + [2] * 3 + [0] * 5)
    rejected = decode(flicker, min_kept=4)
    assert rejected.labels.tolist() == [0] * 4 + [-1] * 5 + [0] * 5
    assert [(each.start, each.end, each.skill) for each in rejected.segments] == [(0, 4, "a"), (9, 14, "a")]
    assert rejected.confidence.tolist() == decode(flicker).confidence.tolist()
    assert decode(flicker, min_segment=4, min_kept=4).labels.tolist() == decode(flicker, min_segment=4).labels.tolist()


def test_uncertain_timesteps_are_rejected_before_short_segments() -> None:
    sure, unsure = certain([0] * 5 + [1] * 4), certain([0, 0, 1, 1, 1], confidence=0.5)
    likely = np.concatenate([sure[:5], unsure, sure[5:]])
    rejected = decode(likely, min_confidence=0.6)
    assert rejected.labels.tolist() == [0] * 5 + [-1] * 5 + [1] * 4
    assert [(each.start, each.end, each.skill) for each in rejected.segments] == [(0, 5, "a"), (10, 14, "b")]
    assert rejected.confidence.tolist() == decode(likely).confidence.tolist()
    assert decode(likely, min_confidence=0.6, min_kept=5).labels.tolist() == [0] * 5 + [-1] * 9


def test_a_trajectory_may_be_rejected_as_a_whole() -> None:
    rejected = decode(certain([0, 1, 1]), min_kept=3)
    assert rejected.labels.tolist() == [-1] * 3
    assert rejected.segments == ()


@given(probabilities(), st.integers(0, 20), st.integers(0, 20))
def test_what_is_kept_is_long_enough_and_unchanged(given_: Probabilities, least: int, kept: int) -> None:
    whole, decoded = decode(given_, min_segment=least), decode(given_, min_segment=least, min_kept=kept)
    assert [each for each in whole.segments if each.end - each.start >= kept] == list(decoded.segments)
    assert ((decoded.labels == whole.labels) | (decoded.labels == -1)).all()
    assert (decoded.labels != -1).sum() == sum(each.end - each.start for each in decoded.segments)


@given(probabilities(), st.floats(0.0, 50.0))
def test_smoothed_probabilities_still_sum_to_one(given_: Probabilities, sigma: float) -> None:
    np.testing.assert_allclose(smooth(given_, sigma=sigma).sum(axis=1), 1.0, atol=1e-5)


def test_twenty_thousand_flickering_timesteps_are_merged_at_once() -> None:
    noise = np.random.default_rng(0).dirichlet(np.ones(5), 20_000).astype(np.float32)
    decoded = decode(noise, smoothing=0.0, min_segment=50)
    assert min(segment.end - segment.start for segment in decoded.segments) >= 50
