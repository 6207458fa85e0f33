"""Goal texts that a policy can act on, and those that it refuses."""

import pytest

from freerein_imitation.model.known_texts import KnownTexts

LEFT = "a yellow block to the left of a green block"
RIGHT = "a yellow block to the right of a green block"
KNOWN = KnownTexts((LEFT, RIGHT))


@pytest.mark.parametrize(
    "text",
    [
        "I want the yellow block left of the green one",
        "could you place the yellow cube to the left of the green cube?",
        "Arrange the blocks so that yellow is left of green!",
        "PUT THE YELLOW BLOCK TO THE LEFT OF THE GREEN BLOCK!!!",
        "please, make the yellow one sit on the left side of the green one",
    ],
)
def test_another_wording_of_a_training_text_is_that_text(text: str) -> None:
    assert KNOWN.read(text).training_text == LEFT


def test_a_relation_of_known_objects_is_read_as_its_caption() -> None:
    read = KNOWN.read("slide the green one to the right of the yellow one")
    assert (read.training_text, read.caption) == (None, "a green block to the right of a yellow block")


@pytest.mark.parametrize(
    ("text", "unknown"),
    [
        (f"do not put {RIGHT}", ("do", "not")),
        (f"don't put {RIGHT}", ("don", "t")),
        (f"never place {RIGHT}", ("never",)),
        ("a yellow block not to the right of a green block", ("not",)),
        (f"{RIGHT}? No!", ("no",)),
        (f"{LEFT}, then {RIGHT}", ("then",)),
        (f"put everything but {LEFT}", ("everything", "but")),
        ("a crimson block to the left of a green block", ("crimson",)),
        (
            "legen Sie den gelben Block links neben den gr\u00fcnen",
            ("legen", "sie", "den", "gelben", "links", "neben", "gr\u00fcnen"),
        ),
        (f"\N{NO ENTRY SIGN} {RIGHT}", ("\N{NO ENTRY SIGN}",)),
        (f"put two {RIGHT}", ("two",)),
        (f"every {RIGHT}", ("every",)),
        (f"{LEFT} on top of a green block", ("on", "top")),
        ("a yellow block to the left of a yellow block", ()),
        (f"{LEFT} {RIGHT}", ()),
        ("a yellow block", ()),
    ],
)
def test_what_the_grammar_cannot_read_is_no_goal_and_its_unknown_words_are_named(
    text: str, unknown: tuple[str, ...]
) -> None:
    read = KNOWN.read(text)
    assert (read.training_text, read.caption, read.unknown, read.did_you_mean) == (None, None, unknown, "")


def test_a_text_near_a_training_text_is_asked_back() -> None:
    read = KNOWN.read("put the yelow block to the left of the green block")
    assert (read.training_text, read.caption, read.unknown, read.did_you_mean) == (None, None, ("yelow",), LEFT)


def test_a_negation_that_was_trained_is_followed_and_its_words_name_no_object() -> None:
    negated = "do not put the yellow block to the right of the green block"
    known = KnownTexts((LEFT, negated))
    assert known.read(f"Please {negated}.").training_text == negated
    read = known.read("do not put the green block to the right of the yellow block")
    assert (read.training_text, read.caption, read.unknown) == (None, None, ("not",))


def test_texts_that_relate_nothing_are_known_by_their_words() -> None:
    known = KnownTexts(("open the gripper", "\u958b\u304f"))
    assert known.read("Could you open the gripper, please?").training_text == "open the gripper"
    assert known.read("\u958b\u304f!").training_text == "\u958b\u304f"
    assert known.read("close the gripper") == known.read("please close the gripper")
    assert known.read("close the gripper").unknown == ("close",)


def test_objects_of_no_training_text_are_known_where_a_policy_finds_them_or_takes_any() -> None:
    text = "put the blue block to the left of the green one"
    caption = "a blue block to the left of a green block"
    assert KNOWN.read(text).caption is None
    assert KnownTexts((LEFT, RIGHT), objects=("a green block", "a blue block")).read(text).caption == caption
    anything = KnownTexts((LEFT, RIGHT), any_object=True)
    assert (
        anything.read("a blue ball to the left of a green block").caption == "a blue ball to the left of a green block"
    )
    assert anything.read(LEFT).training_text == LEFT
    assert anything.read("do not put a blue ball to the left of a green block").caption is None
    assert anything.read("a blue ball").caption is None
