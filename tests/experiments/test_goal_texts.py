"""Goal texts that no grammar was made for: which are understood, and which no reader may follow."""

from pathlib import Path

from experiments.robustness import forbidden_texts, goal_texts, open_wordings
from experiments.workbench import results

GRAMMAR = goal_texts.shipped_grammar()
RESULT = Path(__file__).parents[2] / "experiments" / "results" / "robustness" / "blocks.scatter-texts-seed0.json"


def test_four_fifths_of_the_classes_of_open_wordings_are_understood_and_none_is_misunderstood() -> None:
    found = open_wordings.samples(GRAMMAR)
    assert len(found[open_wordings.WHOLE].counts) == 20
    assert found[open_wordings.WHOLE].mean >= 0.8
    assert found[open_wordings.WRONG].mean == 0


def test_a_class_with_a_misread_text_is_not_understood_whole() -> None:
    assert open_wordings.understood(GRAMMAR, "the red lego on the yellow lego") == open_wordings.meant("red on yellow")
    assert open_wordings.understood(GRAMMAR, "do not put red on yellow") == open_wordings.meant("") == ""


def test_forbidden_texts_are_many_and_none_is_there_twice() -> None:
    made = [text for form in forbidden_texts.FORMS for text in forbidden_texts.texts(form)]
    assert len(forbidden_texts.FORMS) >= 20
    assert len(made) >= 200
    assert len(set(made)) == len(made)


def test_no_reader_follows_a_forbidden_text_and_each_names_why() -> None:
    found = goal_texts.evaluate().samples
    for reader in goal_texts.READERS:
        shares = [found[goal_texts.figure(reader, name)].mean for name in (goal_texts.FOLLOWED, goal_texts.NAMED)]
        assert shares == [0, 1]


def test_no_forbidden_text_but_those_of_the_rarer_forms_is_asked_back() -> None:
    forms = (*forbidden_texts.NEGATIONS, *forbidden_texts.QUANTITIES)
    for read in goal_texts.readers(GRAMMAR).values():
        assert not any(read(text).is_asked_back for form in forms for text in forbidden_texts.texts(form))


def test_a_goal_is_followed_by_the_readers_that_know_its_blocks() -> None:
    readers = goal_texts.readers(GRAMMAR)
    text = "put the yellow block to the left of the green block"
    assert all(read(text).is_followed for read in readers.values())
    others = {name: read("put the red block on the blue block").is_followed for name, read in readers.items()}
    assert others == {goal_texts.REWARD: True, goal_texts.TWO_TASKS: False, goal_texts.CAPTIONS: True}


def test_the_committed_result_is_what_the_readers_make_of_the_texts_today() -> None:
    assert dict(results.load(RESULT).samples) == dict(goal_texts.evaluate().samples)
