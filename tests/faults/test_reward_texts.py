"""Texts that mean harm to the reward service: refused by their length, cut and said so, or answered with a number."""

import base64
import re
import time
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from freerein.goal_text import Grammar
from freerein_reward.model.tokenizer import MAX_TOKENS, Tokenizer

pytestmark = pytest.mark.e2e
MOST = 2_000
LONGEST_TOKENISING_S = 0.02


@pytest.fixture(scope="module")
def reward(start_module_service: Callable[..., Any]) -> Iterator[httpx.Client]:
    """An HTTP client of the service with the shipped models; no text may make it log a fault."""
    service = start_module_service("freerein_reward").until_ready()
    with httpx.Client(base_url=service.url, timeout=120, trust_env=False, verify=False) as client:
        yield client
    assert not re.search(r'"event": "bug"|the model failed|Traceback', service.log.read_text())


def embed(reward: httpx.Client, text: str) -> httpx.Response:
    return reward.post("/v1/embed-goal", json={"goal_text": text})


def is_finite_and_no_longer_than_one(reply: httpx.Response) -> bool:
    vector = np.frombuffer(base64.b64decode(reply.json()["embedding"]["raw"]), np.float32)
    return bool(np.isfinite(vector).all() and 0 < float(np.linalg.norm(vector)) < 1 + 1e-4)


@pytest.mark.fault("R1")
@pytest.mark.parametrize("text", ["a" * 2**20, "red " * 100_000, "é" * (MOST + 1)], ids=["1 MB", "100 k words", "2001"])
def test_a_text_beyond_the_cap_is_refused_with_both_lengths(reward: httpx.Client, refusal: Any, text: str) -> None:
    frames = {"top": {"datatype": "UINT8", "shape": [1, 1, 1, 3], "raw": "AAAA"}}
    for path, body, field in (
        ("/v1/embed-goal", {"goal_text": text}, "goal_text"),
        ("/v1/reward", {"goal_text": text, "frames": frames}, "goal_text"),
        ("/v1/reward", {"goal_text": "a", "rivals": [text], "frames": frames}, "rivals.0"),
    ):
        problem = refusal(reward.post(path, json=body), 422)
        assert (problem["field"], str(MOST) in problem["detail"], str(len(text)) in problem["detail"]) == (
            field,
            True,
            True,
        )


@pytest.mark.fault("R1")
@pytest.mark.parametrize("words", range(MAX_TOKENS - 3, MAX_TOKENS + 3))
def test_a_text_of_more_tokens_than_the_model_takes_is_cut_and_the_reply_says_so(
    reward: httpx.Client, words: int
) -> None:
    reply = embed(reward, " ".join(["red"] * words))

    assert reply.status_code == 200
    assert reply.json()["truncated"] == (words > MAX_TOKENS - 1)  # the text's end is a token, too
    assert is_finite_and_no_longer_than_one(reply)


HOSTILE = {
    "one word": "a" * MOST,
    "words": "a " * (MOST // 2),
    "relations": "on the left of " * (MOST // 15),
    "almost a relation": "on" + " " * (MOST - 2),
    "almost a statement": "put the red block " + "beside on the " * (MOST // 15),
    "right to left": "\u202eقف" * (MOST // 3),
    "emoji": "👩‍👩‍👧‍👦" * (MOST // 7),
    "combining": "a" + "\u0301" * (MOST - 1),
    "combining in the wrong order": "a" + "\u0345\u0301\u0327\u0316\u0334" * (MOST // 5 - 1),
    "grows in lower case": "\u0130" * MOST,
    "grows when normalised": "\ufdfa" * MOST,
}
WORDLESS = [
    "",
    " ",
    "\n\t\r",
    "\u2003\u3000\u00a0",
    " " * MOST,
    "!?",
    "_" * MOST,
    "\u200b" * MOST,
    "\0",
    "\U0010ffff" * MOST,
]


@pytest.mark.fault("R2")
@pytest.mark.parametrize("name", HOSTILE)
def test_a_flood_of_signs_is_answered_with_finite_numbers(reward: httpx.Client, name: str) -> None:
    reply = embed(reward, HOSTILE[name])

    assert reply.status_code == 200
    assert is_finite_and_no_longer_than_one(reply)


@pytest.mark.fault("R2")
@pytest.mark.parametrize("text", WORDLESS, ids=range(len(WORDLESS)))
def test_a_text_without_words_is_refused(reward: httpx.Client, refusal: Any, text: str) -> None:
    assert refusal(embed(reward, text), 422)["field"] == "goal_text"


@pytest.mark.fault("R2")
def test_any_text_is_answered_or_refused(reward: httpx.Client, refusal: Any, fuzz: bool) -> None:
    @settings(max_examples=2_000 if fuzz else 30)
    @given(st.text(max_size=200))
    def check(text: str) -> None:
        reply = embed(reward, text)
        if reply.status_code != 200:
            refusal(reply, 422)
        else:
            assert is_finite_and_no_longer_than_one(reply)

    check()


@pytest.mark.fault("R2")
@pytest.mark.parametrize("name", HOSTILE)
def test_no_text_takes_long_to_tokenise_or_to_read(name: str, least_of_many: Any) -> None:
    tokenizer, grammar = Tokenizer(("red", "block", "on")), Grammar(("a red block", "a blue block"), ("on",))

    def seconds(text: str) -> float:
        begun = time.process_time()
        tokenizer([text])
        grammar.read(text)
        return time.process_time() - begun

    most_s = max(LONGEST_TOKENISING_S, 50 * seconds("red block on " * (MOST // 13)))  # a busy machine slows down both
    assert least_of_many(lambda: seconds(HOSTILE[name]), below=most_s) < most_s
