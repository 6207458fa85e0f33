import numpy as np
import pytest

from freerein import metrics
from freerein.errors import InvalidInput

TRUTH = np.array([0, 0, 0, 0, 2, 2, 2, 2, 1, 1])


def test_labels_equal_to_the_truth_score_one_everywhere() -> None:
    assert metrics.frame_accuracy(TRUTH, TRUTH) == 1.0
    assert metrics.edit_score(TRUTH, TRUTH) == 1.0
    assert metrics.f1_at(TRUTH, TRUTH, overlap=1.0) == 1.0


def test_frame_accuracy_counts_timesteps() -> None:
    assert metrics.frame_accuracy(np.array([0, 0, 0, 1, 2, 2, 2, 2, 1, 0]), TRUTH) == pytest.approx(0.8)


def test_random_cls_guesses_among_the_skills_that_occur() -> None:
    assert metrics.random_cls_accuracy(TRUTH) == pytest.approx(1 / 3)


def test_the_edit_score_looks_at_order_only() -> None:
    assert metrics.edit_score(np.array([0, 2, 2, 2, 2, 2, 2, 2, 2, 1]), TRUTH) == 1.0


def test_the_edit_score_counts_each_flicker() -> None:
    flickering = np.array([0, 1, 0, 0, 2, 2, 2, 2, 1, 1])  # 0 1 0 2 1: two more than 0 2 1
    assert metrics.edit_score(flickering, TRUTH) == pytest.approx(1 - 2 / 5)


@pytest.mark.parametrize(("overlap", "expected"), [(0.5, 1.0), (0.65, 2 / 3), (0.75, 1 / 3), (0.9, 0.0)])
def test_f1_wants_more_overlap_as_its_threshold_rises(overlap: float, expected: float) -> None:
    late = np.array([0, 0, 0, 2, 2, 2, 2, 1, 1, 1])  # overlaps 3/4, 3/5 and 2/3
    assert metrics.f1_at(late, TRUTH, overlap=overlap) == pytest.approx(expected)


def test_a_true_segment_is_found_once_however_often_it_is_cut() -> None:
    cut = np.array([0, 0, 1, 0, 2, 2, 2, 2, 1, 1])  # 0 [0:2) overlaps half of the truth, 0 [3:4) a quarter
    assert metrics.f1_at(cut, TRUTH, overlap=0.25) == pytest.approx(2 * 3 / (5 + 3))


def test_renaming_the_skills_changes_no_score() -> None:
    predicted, names = np.array([0, 1, 0, 0, 2, 2, 1, 2, 1, 1]), np.array([7, 3, 5])
    for score in (metrics.frame_accuracy, metrics.edit_score):
        assert score(names[predicted], names[TRUTH]) == score(predicted, TRUTH)


def test_runs_start_where_labels_change() -> None:
    assert metrics.run_starts(TRUTH).tolist() == [0, 4, 8]
    assert metrics.run_starts(TRUTH[:1]).tolist() == [0]
    assert metrics.run_starts(TRUTH[:0]).tolist() == []


@pytest.mark.parametrize("predicted", [TRUTH[:-1], TRUTH[:, None], TRUTH[:0]])
def test_labels_of_another_shape_are_refused(predicted: np.ndarray) -> None:
    with pytest.raises(InvalidInput, match=r"\(10,\)"):
        metrics.frame_accuracy(predicted, TRUTH)


def test_auroc_is_the_share_of_pairs_in_the_right_order() -> None:
    truth = np.array([True, True, False, False])
    assert metrics.auroc(np.array([0.9, 0.8, 0.2, 0.1]), truth) == 1.0
    assert metrics.auroc(np.array([0.1, 0.2, 0.8, 0.9]), truth) == 0.0
    assert metrics.auroc(np.array([0.9, 0.3, 0.5, 0.1]), truth) == 0.75
    assert metrics.auroc(np.array([0.5, 0.5, 0.5, 0.1]), truth) == 0.75
    assert metrics.auroc(np.full(4, 0.5), truth) == 0.5


def test_auroc_needs_examples_of_both_kinds() -> None:
    for scores, truth in ((np.zeros(2), np.ones(2, bool)), (np.zeros(3), np.array([True, False]))):
        with pytest.raises(InvalidInput):
            metrics.auroc(scores, truth)


def test_a_constant_answer_scores_the_majority_and_balanced_one_over_the_classes() -> None:
    always = np.zeros(len(TRUTH), np.int64)
    assert metrics.majority_accuracy(TRUTH) == metrics.frame_accuracy(always, TRUTH) == 0.4
    assert metrics.balanced_accuracy(always, TRUTH) == pytest.approx(1 / 3)
    assert metrics.balanced_accuracy(np.array([0, 0, 1, 1, 2, 2, 2, 2, 1, 0]), TRUTH) == pytest.approx(2 / 3)


def test_the_calibration_error_is_the_gap_between_confidence_and_frequency() -> None:
    truth = np.array([True, False, False, False])
    assert metrics.expected_calibration_error(np.full(4, 0.25), truth) == 0.0
    assert metrics.expected_calibration_error(np.full(4, 1.0), truth) == 0.75
    assert metrics.expected_calibration_error(np.array([0.95, 0.05, 0.05, 0.05]), truth) == pytest.approx(0.05)
    with pytest.raises(InvalidInput):
        metrics.expected_calibration_error(np.zeros(3), truth)


def test_the_interval_of_a_mean_covers_it_and_shrinks_with_the_sample() -> None:
    rng = np.random.default_rng(0)
    low, high = metrics.mean_interval([0.0, 1.0] * 50, rng=rng, resamples=500)
    assert 0.35 < low < 0.5 < high < 0.65
    assert metrics.mean_interval([2.0] * 5, rng=rng, resamples=10) == (2.0, 2.0)
    with pytest.raises(InvalidInput):
        metrics.mean_interval([], rng=rng)


def test_the_interval_of_ratios_surrounds_the_mean_over_classes_and_needs_trials() -> None:
    rng = np.random.default_rng(0)
    whole = rng.integers(1, 9, (200, 2))
    part = rng.binomial(whole, [0.2, 0.6])
    low, high = metrics.ratio_interval(part, whole, rng=rng)
    value = (part.sum(axis=0) / whole.sum(axis=0)).mean()
    assert low < value < high
    assert high - low == pytest.approx(2 * 1.96 * np.sqrt((0.16 + 0.24) / 900) / 2, rel=0.15)
    assert metrics.ratio_interval(whole, whole, rng=rng) == (1.0, 1.0)
    with pytest.raises(InvalidInput):
        metrics.ratio_interval(np.zeros((0, 1)), np.zeros((0, 1)), rng=rng)


def test_a_class_absent_from_a_resample_does_not_count_in_it() -> None:
    part, whole = np.array([[1, 0], [1, 0], [0, 1]]), np.array([[1, 0], [1, 0], [0, 1]])
    assert metrics.ratio_interval(part, whole, rng=np.random.default_rng(1)) == (1.0, 1.0)


@pytest.mark.parametrize(
    ("scores", "expected"),
    [
        ([0.9, 0.8, 0.2, 0.1], (1 / 1 + 2 / 3) / 2),  # the true ones are found first and third
        ([0.1, 0.9, 0.2, 0.8], (1 / 3 + 2 / 4) / 2),  # third and last
        ([0.5, 0.5, 0.5, 0.5], 0.5),
    ],
)
def test_average_precision_is_the_mean_precision_where_true_examples_are_found(
    scores: list[float], expected: float
) -> None:
    truth = np.array([True, False, True, False])
    assert metrics.average_precision(np.array(scores), truth) == pytest.approx(expected)


def test_average_precision_needs_something_to_find() -> None:
    with pytest.raises(InvalidInput):
        metrics.average_precision(np.zeros(3), np.zeros(3, bool))


@pytest.mark.parametrize(
    ("count", "of", "expected"),
    [(8, 10, (0.4902, 0.9433)), (0, 20, (0.0, 0.1611)), (20, 20, (0.8389, 1.0))],  # Newcombe 1998, method 3
)
def test_the_interval_of_a_share_stays_between_none_and_all(count: int, of: int, expected: tuple[float, float]) -> None:
    assert metrics.wilson_interval(count, of) == pytest.approx(expected, abs=1e-4)
    for wrong in ((0, 0), (3, 2)):
        with pytest.raises(InvalidInput):
            metrics.wilson_interval(*wrong)


def test_the_interval_of_a_median_is_of_order_statistics() -> None:
    assert metrics.median_interval(np.arange(250, 0, -1)) == (110, 141)
    assert metrics.median_interval([0.5]) == (0.5, 0.5)
    with pytest.raises(InvalidInput, match="N at least 1"):
        metrics.median_interval([])
