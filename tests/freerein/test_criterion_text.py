"""Goal texts of models that know the criteria of table 4.1: what is read, and why the rest is not."""

from itertools import permutations, product

import pytest
from hypothesis import given
from hypothesis import strategies as st

from freerein.criteria import CRITERIA, Criterion, View
from freerein.criterion_text import Claim, CriterionCaption, CriterionGrammar, stated_criterion
from freerein.goal_text import COPULAS, VERBS

PHRASES = ("a red block", "a green block", "a blue block")
GRAMMAR = CriterionGrammar(PHRASES, View, ("a pink puck",))

READ = {
    "a red block in between a green block and a blue block": ("in_between", "red green blue"),
    "Please put the blue cube between green and red!": ("in_between", "blue green red"),
    "the red block should be in front of the blue one": ("in_front_of", "red blue"),
    "a green block is next to a blue block": ("close_to", "green blue"),
    "could you put the red one into the blue one": ("inside_of", "red blue"),
    "a red block to the left of a blue block": ("left_of", "red blue"),
}
REFUSED = {
    "a red block behind a green block and a blue block": "`behind` relates 2 things; 3 are named.",
    "a red block in between a green block": "`in_between` relates 3 things; 2 are named.",
    "a red block on top of the red one": "A thing must be named once; a red block is named twice.",
    "a red block between a green block and a green block": "A thing must be named once; a green block is named twice.",
    "a red block": "It states no criterion of different things.",
    "a red block and a blue block": "It states no criterion of different things.",
}


@pytest.mark.parametrize("text", READ)
def test_a_goal_text_is_read_as_a_criterion_of_its_nouns(text: str) -> None:
    name, colours = READ[text]
    nouns = tuple(f"a {colour} block" for colour in colours.split())
    assert GRAMMAR.caption(text) == CriterionCaption(Claim.HOLDS, CRITERIA[name], nouns)
    assert GRAMMAR.read(text).text == CRITERIA[name].wordings[0].format(*nouns)


@pytest.mark.parametrize(
    ("text", "stated"),
    [
        ("Please put the cup near the plate.", ("close_to", ("the cup", "the plate"))),
        ("a jar should be in front of a jar lid", ("in_front_of", ("a jar", "a jar lid"))),
        ("a fork between a plate and a milk glass", ("in_between", ("a fork", "a plate", "a milk glass"))),
        ("a cup near the cup", None),
        ("a cup not near a plate", None),
        ("a cup near a plate and a fork", None),
        ("a fork between a plate", None),
        ("near a plate", None),
        ("a fork in between a plate", None),
        ("a fork in between plate", None),
        ("a fork in contact with a plate", None),
        ("a fork in front the plate", None),
        ("red in front blue", None),
        ("red is in back blue block", None),
        ("a fork in the front drawer", ("inside_of", ("a fork", "the front drawer"))),
        ("a fork next to it", None),
        ("a cup with a handle in the box", ("inside_of", ("a cup with a handle", "the box"))),
    ],
)
def test_what_a_text_states_of_things_is_read_though_no_model_knows_them(
    text: str, stated: tuple[str, tuple[str, ...]] | None
) -> None:
    criterion, nouns = stated_criterion(text) or (None, ())
    assert (stated is None) if criterion is None else ((criterion.name, nouns) == stated)


def test_rivals_are_what_excludes_a_criterion_its_failure_and_absence() -> None:
    assert GRAMMAR.read("red behind blue").rivals == (
        "a red block in front of a blue block",
        "a red block not behind a blue block",
        "a red block or a blue block missing",
    )
    assert GRAMMAR.read("red between green and blue").rivals == (
        "a red block not in between a green block and a blue block",
        "a red block or a green block or a blue block missing",
    )


@pytest.mark.parametrize("criterion", CRITERIA.values(), ids=list(CRITERIA))
def test_every_caption_reads_back_and_only_a_goal_has_rivals(criterion: Criterion) -> None:
    for claim, nouns in product(Claim, permutations(PHRASES, criterion.nouns)):
        caption = CriterionCaption(claim, None if claim is Claim.MISSING else criterion, nouns)
        read = GRAMMAR.read(caption.text)
        assert GRAMMAR.caption(caption.text) == caption
        assert (read.text, read.unknown, read.problem) == (caption.text, (), "")
        assert bool(read.rivals) == (claim is Claim.HOLDS)


@pytest.mark.parametrize("text", REFUSED)
def test_what_states_no_criterion_is_told_why(text: str) -> None:
    read = GRAMMAR.read(text)
    assert (read.problem, read.unknown, read.rivals) == (REFUSED[text], (), ())


def test_a_criterion_of_a_view_that_the_model_has_not_is_refused() -> None:
    read = CriterionGrammar(PHRASES, [View.FRONT]).read("a red block behind a blue block")
    assert read.problem == "`behind` is judged in the side view; the model has front."


def test_unknown_words_are_named_and_the_nearest_criterion_is_asked_back() -> None:
    assert GRAMMAR.read("a red block behind a zeppelin").unknown == ("zeppelin",)
    assert GRAMMAR.read("do not put red behind blue").unknown == ("do", "not")
    read = GRAMMAR.read("a red blok behinde the blue block")
    assert (read.unknown, read.did_you_mean) == (("blok", "behinde"), "a red block behind a blue block")


def test_other_phrases_are_known_but_a_name_that_fits_several_means_one_of_the_fit() -> None:
    grammar = CriterionGrammar(PHRASES, View, ("a red puck", "a pink puck"))
    assert grammar.read("pink behind red").text == "a pink puck behind a red block"
    assert grammar.read("the red puck is behind the red block").text == "a red puck behind a red block"


@given(data=st.data(), name=st.sampled_from(list(CRITERIA)))
def test_a_criterion_in_any_wording_reads_back(data: st.DataObject, name: str) -> None:
    criterion = CRITERIA[name]
    nouns = data.draw(st.permutations(PHRASES))[: criterion.nouns]
    verb, copula = data.draw(st.sampled_from(("", *VERBS))), data.draw(st.sampled_from(("", *COPULAS)))
    said = data.draw(st.sampled_from(criterion.wordings)).replace("{0}", f"{verb} {{0}} {copula}")
    assert GRAMMAR.caption(said.format(*nouns)) == CriterionCaption(Claim.HOLDS, criterion, tuple(nouns))


@given(st.lists(st.sampled_from([*" ".join((*PHRASES, *READ)).split(), "and", "or", "missing", "not"])).map(" ".join))
def test_any_text_is_read_or_not(text: str) -> None:
    read = GRAMMAR.read(text)
    caption = GRAMMAR.caption(text)
    assert (caption is None) == bool(read.unknown or read.problem)
    assert read.text == (caption.text if caption else text)
    assert not read.did_you_mean or GRAMMAR.caption(read.did_you_mean)
