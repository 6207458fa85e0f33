"""A trajectory that arrives bit by bit is decoded as the whole."""

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from freerein_segmentation.core.decoding import decode
from freerein_segmentation.core.stream_decoding import Finished, StreamDecoder
from freerein_segmentation.model import Prediction

SKILLS = "abc"


def prediction(probabilities: npt.NDArray[np.float32]) -> Prediction:
    return Prediction(probabilities, probabilities[:, 0])


def runs(rng: np.random.Generator, timesteps: int) -> npt.NDArray[np.float32]:
    """Returns probabilities (T, K) of runs of random lengths, and of flicker between them."""
    likely = np.eye(3, dtype=np.float32)[np.repeat(rng.integers(0, 3, timesteps), rng.integers(1, 9, timesteps))]
    noise = rng.dirichlet(np.ones(3), timesteps)
    return (0.7 * likely[:timesteps] + 0.3 * noise).astype(np.float32)


@given(
    st.integers(0, 10_000),
    st.lists(st.integers(0, 12), min_size=1, max_size=12),
    st.sampled_from([0.0, 0.7, 1.0, 3.0]),
    st.sampled_from([0.0, 0.75]),
    st.integers(0, 9),
)
def test_labels_are_those_of_the_whole_and_final_once_the_lag_has_passed(
    seed: int, sizes: list[int], smoothing: float, min_confidence: float, min_kept: int
) -> None:
    stops = np.cumsum([*sizes, 1])
    likely = runs(np.random.default_rng(seed), int(stops[-1]))
    options: dict[str, Any] = {"smoothing": smoothing, "min_confidence": min_confidence, "min_kept": min_kept}
    whole = decode(likely, skills=SKILLS, min_segment=0, **options)
    decoder = StreamDecoder(skills=SKILLS, **options)
    parts: list[Finished] = []
    for start, stop in zip([0, *stops[:-2]], stops[:-1], strict=True):
        parts.append(decoder.push(prediction(likely[start:stop])))
        final = parts[-1].start + len(parts[-1].timeline)
        assert final >= stop - decoder.lag
        assert len(decoder.provisional(prediction(likely[:0]))) == stop - final
    parts.append(decoder.finish(prediction(likely[stops[-2] :])))

    assert np.concatenate([each.timeline.labels for each in parts]).tolist() == whole.labels.tolist()
    confidence = np.concatenate([each.timeline.confidence for each in parts])
    np.testing.assert_allclose(confidence, whole.confidence, atol=1e-6)
    in_distribution = np.concatenate([each.timeline.in_distribution for each in parts])
    np.testing.assert_array_equal(in_distribution, likely[:, 0])
    found = [segment for each in parts for segment in each.segments]
    assert [(each.start, each.end, each.skill) for each in found] == [
        (each.start, each.end, each.skill) for each in whole.segments
    ]
    assert [each.confidence for each in found] == pytest.approx([each.confidence for each in whole.segments])


def test_what_a_stream_keeps_does_not_grow_with_time() -> None:
    likely = runs(np.random.default_rng(1), 300)
    decoder = StreamDecoder(skills=SKILLS, smoothing=2.0, min_confidence=0.0, min_kept=0)
    kept = []
    for timestep in range(300):
        decoder.push(prediction(likely[timestep : timestep + 1]))
        kept.append(len(decoder._smoother._window.probabilities))
    assert max(kept) == kept[50] == kept[-1] <= 2 * decoder.lag


def test_provisional_labels_are_those_of_a_trajectory_that_ends_there() -> None:
    likely = runs(np.random.default_rng(1), 60)
    decoder = StreamDecoder(skills=SKILLS, smoothing=1.0, min_confidence=0.0, min_kept=0)
    final = decoder.push(prediction(likely[:30]))
    provisional = decoder.provisional(prediction(likely[30:40]))
    ended = decode(likely[:40], skills=SKILLS, smoothing=1.0, min_segment=0, min_confidence=0.0, min_kept=0)
    assert [*final.timeline.labels, *provisional] == ended.labels.tolist()
