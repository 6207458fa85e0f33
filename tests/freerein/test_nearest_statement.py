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


def understood(text: str) -> str:
    """Returns the caption that a text is read as or asked back with; empty for neither."""
    read = GRAMMAR.read(text)
    return read.text if read.statement else read.did_you_mean


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
    "a red block or a green block on a yellow block": ("or",),
    "the red block is next to a yellow thing next to the blue block": ("next",),
    "a rad block on a yellow block": ("rad",),
    "red on green on yellow": (),
    "a red block on top of a red block": (),
    "a red block on top of a block": (),
    "a red block to the left of a yellow block on top of a blue block": (),
    "the red block on the left, the yellow block on the right": (),
}
HELD_OUT: dict[str, dict[str, str]] = {
    "an aim": {
        "aim for the red block on the yellow block": "red on yellow",
        "what I am after is the green block left of the blue block": "green left blue",
        "achieve: yellow block below red block": "yellow below red",
    },
    "a change": {
        "change the scene such that the red block is on the yellow block": "red on yellow",
        "rearrange things with the green block to the right of the blue block": "green right blue",
        "make it so that the yellow block is far from the red block": "yellow apart red",
    },
    "a deadline": {
        "within a minute, put the red block on the yellow block": "red on yellow",
        "the green block goes left of the blue block at once": "green left blue",
        "quick, yellow block under the red block": "yellow below red",
    },
    "a reason": {
        "put the red block on the yellow block because it looks nice": "red on yellow",
        "since it is in the way, slide the green block right of the blue block": "green right blue",
        "the yellow block below the red block, for stability": "yellow below red",
    },
    "a person": {
        "she puts the red block on the yellow block": "red on yellow",
        "someone placed the green block left of the blue block": "green left blue",
        "we would love the yellow block under the red block": "yellow below red",
    },
    "a report": {
        "I see that the red block is on top of the yellow block": "red on yellow",
        "it looks like the green block is left of the blue block": "green left blue",
        "success means the yellow block is below the red block": "yellow below red",
    },
    "a request to help": {
        "help me put the red block on the yellow block": "red on yellow",
        "give me a hand getting the green block right of the blue block": "green right blue",
        "could someone move the yellow block away from the red block": "yellow apart red",
    },
    "a space too many": {
        "the red bl ock on the yellow block": "red on yellow",
        "the green block to the le ft of the blue block": "green left blue",
        "the yellow block be low the red block": "yellow below red",
    },
    "another article": {
        "my red block on your yellow block": "red on yellow",
        "that there green block left of this here blue block": "green left blue",
        "some guy's yellow block under our red block": "",
    },
    "another form of a block": {
        "the red lego on the yellow lego": "red on yellow",
        "the green piece to the right of the blue piece": "green right blue",
        "the yellow toy block below the red toy block": "yellow below red",
    },
    "brackets": {
        "(red block) on (yellow block)": "red on yellow",
        '"green block" left of "blue block"': "green left blue",
        "[yellow] below [red]": "yellow below red",
    },
    "exactly": {
        "the red block precisely on top of the yellow block": "red on yellow",
        "the green block immediately left of the blue block": "green left blue",
        "the yellow block straight below the red block": "yellow below red",
    },
    "joined": {
        "join the red block and the yellow block, red on top": "",
        "the green block stands and is left of the blue block": "green left blue",
        "lift the yellow block and lower it onto the red block": "yellow on red",
    },
    "letter wrong": {
        "the red blovk on top of the yekkow block": "",
        "the grern block to the right of the blie block": "green right blue",
        "the yeplow block underneaht the red block": "yellow below red",
    },
    "letter more": {
        "the red bllock on topp of the yelllow block": "red on yellow",
        "the greem block to the lefft of the bluee block": "green left blue",
        "the yelloow block undder the red block": "yellow below red",
    },
    "names in front": {
        "Robby, the red block belongs onto the yellow block, please": "red on yellow",
        "arm: move green block left of blue block": "green left blue",
        "dear machine, kindly lay the yellow block beneath the red block": "yellow below red",
    },
    "perfect": {
        "the red block has landed on the yellow block": "red on yellow",
        "the green block having moved left of the blue block": "green left blue",
        "the yellow block had ended up below the red block": "yellow below red",
    },
    "places of things": {
        "where the red block is: on the yellow block": "red on yellow",
        "the place of the green block is left of the blue block": "green left blue",
        "the yellow block finds itself under the red block": "yellow below red",
    },
    "support": {
        "the red block resting safely on the yellow block": "red on yellow",
        "balance the green block on the blue block": "green on blue",
        "the yellow block acting as a base beneath the red block": "yellow below red",
    },
    "verbs": {
        "drag the red block onto the yellow block": "red on yellow",
        "shift the green block to the left of the blue block": "green left blue",
        "tuck the yellow block under the red block": "yellow below red",
    },
}
"""Wordings that the grammar was not made for, and what each means; empty where it does not say."""


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


def test_four_fifths_of_the_classes_of_held_out_wordings_are_understood_and_none_is_misunderstood() -> None:
    assert all(understood(text) in ("", meant(said)) for texts in HELD_OUT.values() for text, said in texts.items())
    right = [all(understood(text) == meant(said) for text, said in texts.items()) for texts in HELD_OUT.values()]
    assert sum(right) >= 0.8 * len(right)


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
