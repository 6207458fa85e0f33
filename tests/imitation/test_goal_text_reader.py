"""Readers of goal texts, and the texts that they learn from; what one reads is beside the fit of a language policy."""

import re

import numpy as np
import pytest
import torch

from freerein_imitation.methods.language.texts import reader_fit as goal_text_reader
from freerein_imitation.methods.language.texts.goal_text_reader import GoalTextReader, Tag
from freerein_imitation.methods.language.texts.reader_fit import fit_goal_text_reader
from freerein_imitation.methods.language.texts.tagged_texts import ADJECTIVES, draw_tagged_text
from freerein_imitation.methods.language.texts.text_encoder import TextEncoder


@pytest.fixture
def few_updates(monkeypatch: pytest.MonkeyPatch) -> None:
    """Readers that have hardly learned."""
    monkeypatch.setattr(goal_text_reader, "_TEXTS", 200)
    monkeypatch.setattr(goal_text_reader, "_STEPS", 20)


@pytest.mark.usefixtures("few_updates")
def test_a_reader_is_the_same_for_the_same_seed(text_encoder_file: bytes) -> None:
    encoder = TextEncoder(text_encoder_file)
    one, again = (fit_goal_text_reader(encoder, seed=3).state_dict() for _ in range(2))
    assert all(torch.equal(one[name], again[name]) for name in one)


@pytest.mark.usefixtures("few_updates")
def test_a_code_takes_part_neither_in_gradients_nor_in_weights_to_train(text_encoder_file: bytes) -> None:
    reader = fit_goal_text_reader(TextEncoder(text_encoder_file), seed=0)
    assert not any(parameter.requires_grad for parameter in reader.parameters())
    assert not reader.encode("red block", TextEncoder(text_encoder_file)).requires_grad
    assert reader.encode("red block", TextEncoder(text_encoder_file)).shape == (GoalTextReader(32).code_size,)


def test_statements_have_two_phrases_and_a_relation_and_other_texts_have_none() -> None:
    rng = np.random.default_rng(0)
    drawn = [draw_tagged_text(rng) for _ in range(400)]
    for text in drawn:
        tags = {tag for _, tag in text if tag is not Tag.NOTHING}
        assert not tags or (tags > {Tag.FIRST, Tag.SECOND} and len(tags) == 3), text
    texts = [" ".join(word for word, _ in text) for text in drawn]
    assert 0.05 < np.mean([all(tag is Tag.NOTHING for _, tag in text) for text in drawn]) < 0.2
    assert "blue" not in ADJECTIVES
    assert not any(
        re.search(r"\b(move|slide|make|want|cube|goes|stays|on the (left|right) of)\b", text) for text in texts
    )
