import numpy as np
import pytest

from freerein_reward.methods.shared.presence import alone_in_place, presence_in_dataset


def test_each_phrase_is_judged_by_the_two_groups_that_its_heat_forms() -> None:
    # The groups are those of the square root: 0.4 and 1.0 three times each, and 2.2 and 2.8; their deviations are 0.3.
    heat = np.square([0.4, 1.0, 0.4, 1.0, 2.2, 2.8, 0.4, 1.0])
    unsure = np.full((8, 2), 0.5)
    judged = presence_in_dataset(np.stack([heat, 4 * heat[::-1]], axis=1), unsure)

    odds = np.exp(((1.5**2 - 0.3**2) / 0.3**2) / 2)  # of the nearer group at 1.0 and at 2.2, were the groups as large
    assert judged.probability[[1, 3, 7], 0] == pytest.approx([1 / (1 + 3 * odds)] * 3, rel=1e-6)
    assert 1 - judged.probability[4, 0] == pytest.approx(1 / (1 + odds / 3), rel=1e-6)
    assert judged.probability[[0, 2, 6], 0].max() < 1e-20
    assert judged.probability[5, 0] == 1.0
    assert judged.half_heat[0] == pytest.approx(1.6**2)
    np.testing.assert_array_equal(judged.probability[:, 1] > 0.5, heat[::-1] > 2)


@pytest.mark.parametrize(
    ("heat", "half_heat"),
    [
        (np.square(np.linspace(2.0, 6.0, 9)), 8.0),
        (np.square(np.linspace(0.2, 1.0, 9)), 1.0),
        (np.square([1.98, 1.99, 2.0, 2.01, 2.02]), 2.0),
        (np.zeros(9), 1.0),
        (np.array([36.0]), 18.0),
    ],
    ids=["spread out", "spread out below", "alike", "none", "one image"],
)
def test_where_the_heat_forms_one_group_the_grounding_model_is_believed(heat: np.ndarray, half_heat: float) -> None:
    presence = np.linspace(0.1, 0.9, len(heat))[:, None]
    judged = presence_in_dataset(heat[:, None], presence)

    np.testing.assert_array_equal(judged.probability, presence)
    assert judged.half_heat == pytest.approx([half_heat])


def test_of_two_phrases_in_one_place_only_the_one_with_more_heat_is_alone() -> None:
    x = np.array([[0.50, 0.52, 0.80]] * 3)
    y = np.array([[0.30, 0.30, 0.30]] * 3)
    heat = np.array([[4.0, 2.0, 1.0], [4.0, 4.0, 1.0], [4.0, 2.0, 1.0]])
    presence = np.array([[0.9, 0.9, 0.9], [0.9, 0.9, 0.9], [0.4, 0.9, 0.9]])

    assert alone_in_place(x, y, presence, heat, epsilon=0.1).tolist() == [
        [True, False, True],
        [True, True, True],  # neither has more heat
        [True, True, True],  # the one with more heat is not present
    ]
    assert alone_in_place(x, y, presence, heat, epsilon=0.02 - 1e-9).all()
