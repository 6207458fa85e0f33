import numpy as np

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
    assert TOKENIZER(["\ud800_\u05d0 " * 500]).ids.shape[1] <= MAX_TOKENS
