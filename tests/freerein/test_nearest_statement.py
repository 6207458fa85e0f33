"""Goal texts that no grammar reads: what is asked back, and what is refused without a question."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from freerein.goal_text import MAX_UNKNOWN, Grammar
from freerein.nearest_statement import NEGATIONS, QUANTITIES
from freerein.relations import CANONICAL_WORDINGS, SpatialRelation, caption

PHRASES = ("a red block", "a green block", "a yellow block", "a blue block")
GRAMMAR = Grammar(PHRASES, tuple(" ".join((*PHRASES, *CANONICAL_WORDINGS.values())).split()))
RELATIONS = {"left": 0, "right": 1, "on": 2, "below": 3, "apart": 4}


def meant(said: str) -> str:
    """Returns the caption of a short form such as `red on yellow`; empty for an empty one."""
    first, relation, second = said.split() or ("", "", "")
    return said and caption(f"a {first} block", SpatialRelation(RELATIONS[relation]), f"a {second} block")


READ = {
    "there is a red block on top of a yellow block": "red on yellow",
    "I'd like the red block to go to the left of the green block": "red left green",
    "can you please make sure that there is a red block below a blue block": "red below blue",
    "the red block must stay on the yellow block": "red on yellow",
    "the red one has to sit right of the blue one": "red right blue",
    "a red block that is far from the green block": "red apart green",
}
ASKED = {
    "the red block is next to the yellow block": "red left yellow",
    "put the red block and the yellow block next to each other": "red left yellow",
    "keep the red block and the yellow block apart": "red apart yellow",
    "the red blocks are on the yellow blocks": "red on yellow",
    "a red blok on top of a yelow block": "red on yellow",
    "a redblock on the yellowblock": "red on yellow",
    "the bright red block is right on top of the yellow block": "red on yellow",
    "on top of the yellow block is a red block": "red on yellow",
    "the yellow block has a red block on top of it": "red on yellow",
    "put the red block at the yellow block's left": "red left yellow",
    "the yellow block's left side has the red block": "red left yellow",
    "a red block further left than a yellow block": "red left yellow",
    "move the red block until it is on the yellow block": "red on yellow",
}
REFUSED: dict[str, tuple[str, ...]] = {
    "do not put the red block on the yellow block": ("do", "not"),
    "do nott put the red block on the yellow block": ("do", "nott"),
    "put no red block on the yellow block": ("no",),
    "the red block on the yellow block, without fail": ("without", "fail"),
    "two red blocks on a yellow block": ("two", "blocks"),
    "every red block on a yellow block": ("every",),
    "all the red blocks on the yellow block": ("all", "blocks"),
    "2 red blocks on a yellow block": ("2", "blocks"),
    "\N{NO ENTRY SIGN} a red block on a yellow block": ("\N{NO ENTRY SIGN}",),
    "remove the red block from on top of the yellow block": ("remove",),
    "it is false that the red block is on the yellow block": ("it", "false"),
    "nobody may put the red block on the yellow block": ("nobody", "may"),
    "the red block is anywhere other than on the yellow block": ("anywhere", "other", "than"),
    "it is forbidden to put the red block on the yellow block": ("it", "forbidden"),
    "the red block fails to be on the yellow block": ("fails",),
    "I would hate to see the red block on the yellow block": ("hate", "see"),
    "only one red block on the yellow block": ("only",),
    "a couple of red blocks on the yellow block": ("couple", "blocks"),
    "a dozen red blocks on the yellow block": ("dozen", "blocks"),
    "a red block or a green block on a yellow block": ("or",),
    "the red block is next to a yellow thing next to the blue block": ("next",),
    "a rad block on a yellow block": ("rad",),
    "red on green on yellow": (),
    "a red block on top of a red block": (),
    "a red block on top of a block": (),
    "a red block to the left of a yellow block on top of a blue block": (),
    "the red block on the left, the yellow block on the right": (),
}


@pytest.mark.parametrize("text", READ)
def test_what_a_sentence_begins_with_does_not_matter(text: str) -> None:
    assert (GRAMMAR.read(text).text, GRAMMAR.read(text).unknown) == (meant(READ[text]), ())


@pytest.mark.parametrize("text", ASKED)
def test_a_text_near_a_statement_is_asked_back_and_not_taken_for_it(text: str) -> None:
    read = GRAMMAR.read(text)
    assert (read.statement, read.text, read.did_you_mean) == (None, text, meant(ASKED[text]))


@pytest.mark.parametrize("text", REFUSED)
def test_a_text_that_states_nothing_or_something_else_is_near_nothing_and_never_rewarded(text: str) -> None:
    read = GRAMMAR.read(text)
    assert (read.statement, read.did_you_mean, read.unknown) == (None, "", REFUSED[text])
    assert read.unknown or not read.rivals


@given(
    st.sampled_from(["red on yellow", "the red cube is to the left of the blue one", "put red under the yellow block"]),
    st.sampled_from((*NEGATIONS, *QUANTITIES)),
    st.integers(0),
)
def test_a_negation_or_a_quantity_anywhere_is_neither_read_nor_left_out_but_named(
    text: str, word: str, place: int
) -> None:
    said = text.split()
    said.insert(place % (len(said) + 1), word)
    read = GRAMMAR.read(" ".join(said))
    assert (read.statement, read.did_you_mean, read.unknown) == (None, "", (word,))


def test_a_negation_in_a_phrase_of_the_model_is_a_part_of_its_name() -> None:
    grammar = Grammar(("a no entry sign", "a t block"), ())
    assert grammar.read("put the t block on the no entry sign").text == "a t block on top of a no entry sign"
    assert grammar.read("do not put the t block on the no entry sign").unknown == ("do", "not")


def test_only_the_first_unknown_words_are_taken_for_typos() -> None:
    strange = " ".join(f"word{number}" for number in range(MAX_UNKNOWN))
    assert GRAMMAR.read(f"the red blok on the yelow block, {strange}").did_you_mean
    assert not GRAMMAR.read(f"{strange}, the red block on the yelow block").did_you_mean
