"""Captions of what a grounding model found."""

from types import SimpleNamespace

import numpy as np

from freerein_reward.core.grounding import captions

PHRASES = ("a red block", "a blue block", "a cat")


def test_each_ordered_pair_of_things_that_are_shown_is_told_of() -> None:
    found = SimpleNamespace(
        heatmaps=np.zeros((2, 3, 4, 4), np.float32),
        x=np.array([[0.5, 0.5, 0.1], [0.2, 0.8, 0.5]]),
        y=np.array([[0.4, 0.5, 0.1], [0.5, 0.5, 0.5]]),
        presence=np.array([[0.9, 0.9, 0.1], [0.9, 0.1, 0.1]]),
    )

    told = captions(found, PHRASES, epsilon=0.1, aspects=np.ones(2))

    assert told == [("a red block on top of a blue block", "a blue block below a red block"), ()]


def test_stacked_things_are_stacked_in_a_wide_image_too() -> None:
    width, height, side = 1280, 720, 64  # two cubes, one 3 pixels to the left of the other
    places = np.array([[[640.0, 360 - side], [643.0, 360.0]]])
    found = SimpleNamespace(x=places[..., 0] / width, y=places[..., 1] / height, presence=np.ones((1, 2)))
    (told,) = captions(found, PHRASES[:2], epsilon=side / width, aspects=np.array([height / width]))
    assert told == ("a red block on top of a blue block", "a blue block below a red block")
