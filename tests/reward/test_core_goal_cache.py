"""The cache of goal embeddings: bounded whatever is asked, keyed by what decides an embedding."""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
import numpy.typing as npt
import orjson
import pytest

from freerein.goal_text import Grammar
from freerein.types.common import ModelRef
from freerein_reward.core import GoalCache
from freerein_reward.model import ImageEmbeddings

REF = ModelRef("default", "0" * 12)
FEATURES = 64


class Lengths:
    """Embeds texts as their lengths, and counts how many it was asked for."""

    cameras = ("top",)
    aspects: ClassVar[dict[str, float]] = {}
    grammar = Grammar((), ())

    def __init__(self) -> None:
        self.embedded = 0

    def preprocess(self, image: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
        raise NotImplementedError

    def embed_images(self, _views: object) -> ImageEmbeddings:
        raise NotImplementedError

    def similarities(self, images: npt.NDArray[np.float32], texts: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        return (images @ texts.T).clip(-1, 1)

    def in_distribution(self, _distances: object, _similarities: object) -> npt.NDArray[np.float32]:
        raise NotImplementedError

    def embed_texts(self, texts: Sequence[str]) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_]]:
        self.embedded += len(texts)
        lengths = np.array([[len(text)] * FEATURES for text in texts], np.float32)
        lengths[[text == "nan" for text in texts]] = np.nan
        return lengths, np.zeros(len(texts), np.bool_)


@pytest.mark.fault("R4")
def test_distinct_goals_without_end_take_no_more_memory_than_allowed() -> None:
    cache, model = GoalCache(100_000), Lengths()

    for number in range(0, 10_000, 50):
        cache.embed(REF, model, [f"goal {one}" * 10 for one in range(number, number + 50)])

    assert 0.9 * 100_000 < cache.held_bytes <= 100_000
    assert len(cache) * FEATURES * 4 < cache.held_bytes
    assert cache.embed(REF, model, ["goal 1"])["goal 1"].vector[0] == len("goal 1")


@pytest.mark.fault("R4")
def test_texts_that_came_to_hold_their_utf_8_form_count_as_much_when_they_are_dropped() -> None:
    cache, model = GoalCache(100_000), Lengths()

    for number in range(300):
        text = f"{number:04}" + "ü" * 500
        cache.embed(REF, model, [text])
        orjson.dumps(text)  # as every reply that names it

    assert len(cache) < 100_000 / (2 * 500 + FEATURES * 4)


@pytest.mark.fault("R4")
def test_what_is_kept_is_no_view_of_the_batch_it_came_from() -> None:
    vector = GoalCache(100_000).embed(REF, Lengths(), ["a", "b"])["a"].vector

    assert vector.base is None


def test_what_was_asked_for_last_stays() -> None:
    cache, model = GoalCache(10_000), Lengths()

    for number in range(100):
        cache.embed(REF, model, ["the task", f"another {number}"])

    assert model.embedded == 101


@pytest.mark.fault("R4")
def test_another_version_embeds_anew() -> None:
    cache, model = GoalCache(100_000), Lengths()

    cache.embed(REF, model, ["a"])
    cache.embed(ModelRef("default", "1" * 12), model, ["a"])

    assert model.embedded == 2


def test_what_is_not_finite_is_not_kept() -> None:
    cache, model = GoalCache(100_000), Lengths()

    cache.embed(REF, model, ["nan", "a"])

    assert len(cache) == 1


def test_nothing_is_kept_where_nothing_may_be() -> None:
    cache, model = GoalCache(0), Lengths()

    assert set(cache.embed(REF, model, ["a", "b", "a"])) == {"a", "b"}
    assert (len(cache), cache.held_bytes) == (0, 0)
