import time

import numpy as np
import pytest

from freerein_reward.model.tokenizer import END, MAX_TOKENS, Tokenizer

TOKENIZER = Tokenizer(("a", "red", "block"))


def test_words_are_found_whatever_their_case_and_punctuation() -> None:
    ids, truncated = TOKENIZER(["a red block", "A, RED zeppelin!"])
    assert np.array_equal(ids[0, :2], ids[1, :2])
    assert ids[0, 2] != ids[1, 2]
    assert truncated.tolist() == [False, False]
    assert (ids == END).sum(axis=1).tolist() == [1, 1]


def test_a_long_text_is_cut_and_says_so() -> None:
    tokens = TOKENIZER(["red " * 1000, "red " * (MAX_TOKENS - 1)])
    assert tokens.ids.shape == (2, MAX_TOKENS)
    assert tokens.truncated.tolist() == [True, False]
    assert tokens.ids[0, -1] == END


@pytest.mark.parametrize("sign", ["\U0001f9f1", "\u05d0", "e\u0301\u0302\u0303", "\u202e", "\ud800", "_", " "])
def test_two_thousand_characters_of_anything_take_no_time(sign: str) -> None:
    text = (sign * 2000)[:2000]
    seconds = []
    for _ in range(5):  # other threads and garbage only add to it
        begun = time.process_time()
        tokens = TOKENIZER([text])
        seconds.append(time.process_time() - begun)
    assert min(seconds) < 0.02
    assert tokens.ids.shape[1] <= MAX_TOKENS
