"""Goal texts as users write them: what is read, as what, and which words are named as unknown."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from freerein.goal_text import (
    ARTICLES,
    COPULAS,
    MAX_UNKNOWN,
    MAX_UNKNOWN_CHARACTERS,
    VERBS,
    WORDINGS,
    Grammar,
    Statement,
    noun_phrases,
    rival_captions,
    words,
)
from freerein.relations import CANONICAL_WORDINGS, SpatialRelation

PHRASES = ("a red block", "a green block", "a yellow block", "a blue block")
VOCABULARY = tuple(dict.fromkeys(" ".join((*PHRASES, *CANONICAL_WORDINGS.values(), "further than")).split()))
GRAMMAR = Grammar(PHRASES, VOCABULARY)

CLASSES: dict[str, tuple[str, ...]] = {
    "as trained": ("a red block on top of a yellow block",),
    "case and punctuation": (
        "A red block on top of a yellow block.",
        "  A RED block,\non top of a YELLOW block!",
        "“a red block” on—top—of a yellow block",
        "a \uff52\uff45\uff44 block on top of a yellow block",
    ),
    "other words for the relation": (
        "a red block above a yellow block",
        "a red block onto a yellow block",
        "a red block directly on top of a yellow block",
        "a red block on the top of a yellow block",
    ),
    "articles": (
        "the red block on the yellow block",
        "red block on yellow block",
        "this red block on that yellow block",
    ),
    "other nouns": ("a red cube on a yellow cube", "the red one on the yellow one", "red thing on yellow object"),
    "no noun": ("red on top of yellow", "the red on the yellow block"),
    "sentences": ("The red block is on the yellow block.", "the red one should be on top of the yellow one"),
    "requests": (
        "Could you put the red block on the yellow one, please?",
        "I want the red cube on the yellow cube",
        "I would like you to place the red block on top of the yellow block.",
        "make sure that the red one stays on the yellow one",
        "Arrange the blocks so that red is on top of yellow!",
        "make red sit on yellow",
    ),
    "imperatives": (
        "put the red block on the yellow one",
        "Please move the red cube onto the yellow cube.",
        "stack the red block on top of the yellow block, please",
    ),
}
SIDES = (
    "a red block to the left of a yellow block",
    "a red block left of a yellow block",
    "a red block beside, on the left of a yellow block",
    "the red block is next to, to the left of, the yellow block",
    "place the red cube on the left-hand side of the yellow one",
    "a red block just at the left of a yellow block",
    "the red block sits close on the left side of the yellow block",
)
UNREAD: dict[str, tuple[str, ...]] = {
    "a crimson block on top of a yellow block": ("crimson",),
    "put the crimson block on the amber block, the crimson one": ("crimson", "amber"),
    "a red block not on top of a yellow block": ("not",),
    "could you not put the red block on the yellow block": ("not",),
    "do not arrange the blocks so that red is on yellow": ("do", "not", "blocks"),
    "could you see a red block": ("see",),
    "could you a red block": ("could", "you"),
    "a red block on top of a yellow block and a blue block": ("and",),
    "a red block beside a yellow block": ("beside",),
    "the red block is next to the yellow block": ("next",),
    "a red 🧱 on top of a yellow 🧱": ("🧱",),
    "a re\u0336d block on top of a yellow block": ("re", "\u0336"),
    "the cube is on top of a yellow block": ("cube", "is"),
    "a red block on top of a red block": (),
    "a red block on top of a yellow block below a green block": (),
    "a red block further left than a yellow block": (),
    "a red block": (),
    "block": (),
    "!?": (),
}


@pytest.mark.parametrize("name", CLASSES)
def test_a_statement_is_read_however_it_is_put(name: str) -> None:
    expected = Statement("a red block", SpatialRelation.ON_TOP_OF, "a yellow block")
    assert {GRAMMAR.read(text).statement for text in CLASSES[name]} == {expected}


def test_beside_is_read_where_the_side_is_said() -> None:
    expected = Statement("a red block", SpatialRelation.LEFT_OF, "a yellow block")
    assert {GRAMMAR.read(text).statement for text in SIDES} == {expected}


def test_the_order_of_the_phrases_counts() -> None:
    read = GRAMMAR.read("the yellow block is right of the red one").statement
    assert read == Statement("a yellow block", SpatialRelation.RIGHT_OF, "a red block")


def test_a_statement_is_given_to_the_model_as_its_caption_with_the_captions_of_the_other_relations_as_rivals() -> None:
    read = GRAMMAR.read("Put the red cube on the yellow one.")
    assert (read.text, read.unknown) == ("a red block on top of a yellow block", ())
    assert read.rivals == (
        "a red block to the left of a yellow block",
        "a red block to the right of a yellow block",
        "a red block below a yellow block",
        "a red block apart from a yellow block",
        "a red block or a yellow block missing",
    )
    assert read.rivals[:-1] == rival_captions(read.text)


def test_the_caption_of_a_missing_object_is_read_and_its_words_alone_are_unknown() -> None:
    read = GRAMMAR.read("A red block or a yellow block missing.")
    assert (read.text, read.rivals, read.unknown) == ("a red block or a yellow block missing", (), ())
    assert GRAMMAR.read("a red block or a green block on a yellow block").unknown == ("or",)


@pytest.mark.parametrize("text", UNREAD)
def test_what_is_no_statement_is_left_as_it_is_and_its_unknown_words_are_named(text: str) -> None:
    read = GRAMMAR.read(text)
    assert (read.statement, read.text, read.unknown) == (None, text, UNREAD[text])


def test_a_name_must_fit_one_phrase_only() -> None:
    grammar = Grammar(("a red block", "a red ball", "a big cube", "a big block", "a cup"), ())
    firsts = {
        name: grammar.read(f"{name} on the cup").statement
        for name in ("red block", "red sphere", "big cube", "big block", "red one", "red", "big thing", "thing", "one")
    }
    read = {name: statement.first for name, statement in firsts.items() if statement}
    assert read == {
        "red block": "a red block",
        "red sphere": "a red ball",
        "big cube": "a big cube",
        "big block": "a big block",
    }


def test_the_words_of_the_grammar_are_known_to_a_model_without_phrases() -> None:
    read = Grammar((), ("a", "red", "block")).read("put a red block on the zeppelin")
    assert (read.statement, read.unknown, read.rivals) == (None, ("zeppelin",), ())
    near = Grammar((), ("a", "red", "block"), untold=["close"]).read("a red block close to a block")
    assert (near.text, near.unknown) == ("a red block a block", ())


def test_unknown_words_are_few_short_and_distinct() -> None:
    unknown = GRAMMAR.read(" ".join(["x" * 100, "x" * 200, *(f"word{number}" for number in range(100))])).unknown
    assert unknown[:2] == ("x" * MAX_UNKNOWN_CHARACTERS, "word0")
    assert len(unknown) == len(set(unknown)) == MAX_UNKNOWN


def test_noun_phrases_are_those_of_texts_that_relate_two() -> None:
    texts = (
        "put the red cup on the plate",
        "A red cup is to the left of a big blue box.",
        "could you move the plate under the lamp, please",
        *(
            "open the gripper",
            "do not put the sponge on the plate",
            "the pan is not on the stove",
            "put it on",
            "on the pan",
            "put it on the pan",
        ),
    )
    assert noun_phrases(texts) == ("the red cup", "the plate", "a big blue box", "the lamp")


def test_a_text_without_a_relation_has_no_rivals() -> None:
    assert rival_captions("an inverted pendulum") == ()


def test_letters_keep_their_marks_however_they_are_encoded() -> None:
    assert words("Un bloc carre\u0301") == words("un BLOC carr\u00e9") == ("un", "bloc", "carr\u00e9")


_VARIANTS = {
    phrase: (colour, f"{colour} block", f"{colour} cube", f"{colour} one", f"{colour} object", f"{colour} thing")
    for phrase in PHRASES
    for colour in phrase.split()[1:2]
}
_STATEMENTS = st.builds(
    lambda pair, relation: Statement(pair[0], relation, pair[1]),
    st.permutations(PHRASES),
    st.sampled_from(SpatialRelation),
)


@given(data=st.data(), statement=_STATEMENTS)
def test_a_statement_in_any_wording_reads_back(data: st.DataObject, statement: Statement) -> None:
    drawn = [
        data.draw(st.sampled_from(choices))
        for choices in (
            ("", "please"),
            ("", *VERBS),
            ("", *ARTICLES),
            _VARIANTS[statement.first],
            ("", *COPULAS),
            WORDINGS[statement.relation],
            ("", *ARTICLES),
            _VARIANTS[statement.second],
            ("", "please"),
        )
    ]
    said = [data.draw(st.sampled_from((str.lower, str.upper, str.title)))(part) for part in drawn if part]
    between = data.draw(st.sampled_from((" ", ", ", "-", "\u00a0", "... ")))
    read = GRAMMAR.read(between.join(said) + data.draw(st.sampled_from(("", ".", "!", " ?!"))))
    assert (read.statement, read.text, read.unknown) == (statement, statement.caption, ())


@given(
    st.one_of(st.text(max_size=2000), st.lists(st.sampled_from([*VOCABULARY, *VERBS, "is", "beside"])).map(" ".join))
)
def test_any_text_is_read_or_not(text: str) -> None:
    read = GRAMMAR.read(text)
    assert read.statement is None or not (read.unknown or read.did_you_mean)
    assert GRAMMAR.read(read.did_you_mean).text == read.did_you_mean
    assert read.text == (read.statement.caption if read.statement else text)
    assert all(0 < len(word) <= MAX_UNKNOWN_CHARACTERS for word in read.unknown)
    assert len(read.rivals) in (0, len(SpatialRelation) - 1, len(SpatialRelation))
