"""Reading goal texts: one meaning has one code, however it is said and whatever it names."""

import re
from collections.abc import Callable

import numpy as np
import pytest
import torch

from freerein_imitation.model.goal_text_reader import GoalTextReader, Tag
from freerein_imitation.model.text_encoder import TextEncoder
from freerein_imitation.training import minilm
from freerein_imitation.training.goal_text_reader import fit_goal_text_reader
from freerein_imitation.training.tagged_texts import ADJECTIVES, draw_tagged_text

Encode = Callable[[str], torch.Tensor]

HELD_OUT = (
    "{0} {side} of {1}",
    "the {0} block goes to the {side} of the {1} one",
    "I want the {0} block {side} of the {1} one",
    "a {0} block on the {side} of a {1} block",
    "could you place the {0} cube to the {side} of the {1} cube?",
    "Arrange the blocks so that {0} is {side} of {1}!",
    "MOVE THE {0} BLOCK TO THE {side} OF THE {1} BLOCK",
    "A {1} block to the {other} of a {0} block",
    "the {1} cube stays on the {other} side of the {0} cube",
    "slide the {1} one to the {other} of the {0} one",
    "make {1} sit {other} of {0}, please",
)
"""Wordings and converses of which no text that a reader is trained on has the words."""

NO_STATEMENTS = ("dance", "put the yellow block away", "what time is it?", "", "the green block")


@pytest.fixture(scope="module")
def encode() -> Encode:
    """A fitted reader's codes, with the pretrained text encoder."""
    encoder = TextEncoder(minilm.read())
    reader = fit_goal_text_reader(encoder, seed=0)
    return lambda text: reader.encode(text, encoder)


def statement(first: str, side: str, second: str) -> str:
    return f"a {first} block to the {side} of a {second} block"


def test_nine_of_ten_held_out_wordings_and_converses_have_the_code_of_their_meaning(encode: Encode) -> None:
    right = []
    for colours in (("yellow", "green"), ("green", "yellow"), ("blue", "red"), ("red", "blue")):
        codes = [encode(statement(colours[0], side, colours[1])) for side in ("left", "right")]
        for wording in HELD_OUT:
            left = place_between(*codes, encode(wording.format(*colours, side="left", other="right")))
            mirrored = place_between(*codes, encode(wording.format(*colours, side="right", other="left")))
            right += [left > 0.8, mirrored < -0.8]
    assert np.mean(right) >= 0.9


def test_a_converse_differs_in_what_is_to_be_moved_and_less_than_any_other_goal(encode: Encode) -> None:
    goal, converse = encode(statement("red", "left", "green")), encode(statement("green", "right", "red"))
    others = [
        encode(statement(*other))
        for other in (("red", "right", "green"), ("red", "left", "yellow"), ("black", "left", "green"))
    ]
    difference = float((goal - converse).norm())
    assert 0 < difference < min(float((goal - other).norm()) for other in others)


def test_what_states_no_relation_is_between_all_statements(encode: Encode) -> None:
    left, right = (encode(statement("yellow", side, "green")) for side in ("left", "right"))
    for text in (*NO_STATEMENTS, statement("red", "left", "blue"), "a yellow block on top of a green block"):
        assert abs(place_between(left, right, encode(text))) < 0.2, text


def place_between(left: torch.Tensor, right: torch.Tensor, code: torch.Tensor) -> float:
    """Returns 1 for the code `left`, -1 for `right`, and 0 for what is as near to one as to the other."""
    axis = (left - right) / 2
    return float((code - (left + right) / 2) @ axis / axis.square().sum())


def test_a_reader_is_the_same_for_the_same_seed(text_encoder_file: bytes) -> None:
    encoder = TextEncoder(text_encoder_file)
    one, again = (fit_goal_text_reader(encoder, seed=3).state_dict() for _ in range(2))
    assert all(torch.equal(one[name], again[name]) for name in one)


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
