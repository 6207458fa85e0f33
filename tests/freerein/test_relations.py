import numpy as np
import pytest

from freerein.relations import SpatialRelation, classify_relation

EPSILON = 0.1


@pytest.mark.parametrize(
    ("x", "y", "relation"),
    [
        (-0.12, 0.0, SpatialRelation.LEFT_OF),
        (0.12, 0.0, SpatialRelation.RIGHT_OF),
        (0.04, -0.1, SpatialRelation.ON_TOP_OF),
        (-0.04, 0.1, SpatialRelation.BELOW),
        (0.0, -0.2, SpatialRelation.APART_FROM),
        (0.3, 0.0, SpatialRelation.APART_FROM),
    ],
)
def test_relations_are_classified_in_image_coordinates(x: float, y: float, relation: SpatialRelation) -> None:
    assert classify_relation(np.array([0.5 + x, 0.5 + y]), np.array([0.5, 0.5]), epsilon=EPSILON) == relation


def test_the_relation_of_swapped_objects_is_the_inverse() -> None:
    rng = np.random.default_rng(0)
    first, second = rng.uniform(0, 1, size=(2, 1000, 2))
    inverse = np.array(
        [
            SpatialRelation.RIGHT_OF,
            SpatialRelation.LEFT_OF,
            SpatialRelation.BELOW,
            SpatialRelation.ON_TOP_OF,
            SpatialRelation.APART_FROM,
        ]
    )
    there, back = classify_relation(first, second, epsilon=EPSILON), classify_relation(second, first, epsilon=EPSILON)
    assert np.array_equal(inverse[there], back)
