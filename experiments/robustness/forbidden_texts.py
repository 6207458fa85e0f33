"""Texts that say what must not be, or how many blocks: no policy may act on them, and no reward may read them.

All forms but the rarer ones were chosen before the grammar was asked about any.
"""

from freerein.relations import CANONICAL_WORDINGS

NEGATIONS = (
    "do not put the {first} block {words} the {second} block",
    "don't put the {first} block {words} the {second} block",
    "don\N{RIGHT SINGLE QUOTATION MARK}t put the {first} block {words} the {second} block",
    "dont put the {first} block {words} the {second} block",
    "Do NOT put the {first} block {words} the {second} block!",
    "never put the {first} block {words} the {second} block",
    "under no circumstances put the {first} block {words} the {second} block",
    "I do not want the {first} block {words} the {second} block",
    "the {first} block must not be {words} the {second} block",
    "the {first} block is not {words} the {second} block",
    "the {first} block isn't {words} the {second} block",
    "the {first} block can't be {words} the {second} block",
    "the {first} block cannot be {words} the {second} block",
    "the {first} block should never be {words} the {second} block",
    "the {first} block is no longer {words} the {second} block",
    "it is not true that the {first} block is {words} the {second} block",
    "it is false that the {first} block is {words} the {second} block",
    "no {first} block {words} the {second} block",
    "nothing {words} the {second} block, least of all the {first} block",
    "nobody may put the {first} block {words} the {second} block",
    "put neither the {first} block nor any other {words} the {second} block",
    "the {second} block without a {first} block {words} it",
    "put the {first} block anywhere but {words} the {second} block",
    "put the {first} block anywhere except {words} the {second} block",
    "the {first} block is anywhere other than {words} the {second} block",
    "the {first} block is anything but {words} the {second} block",
    "put the {first} block elsewhere instead of {words} the {second} block",
    "put the {first} block aside rather than {words} the {second} block",
    "keep the {first} block off the {second} block",
    "keep the {first} block from being {words} the {second} block",
    "stop the {first} block from going {words} the {second} block",
    "prevent the {first} block from being {words} the {second} block",
    "avoid a {first} block {words} a {second} block",
    "avoid putting the {first} block {words} the {second} block",
    "refrain from putting the {first} block {words} the {second} block",
    "it is forbidden to put the {first} block {words} the {second} block",
    "the opposite of the {first} block {words} the {second} block",
    "the {first} block fails to be {words} the {second} block",
    "I would hate to see the {first} block {words} the {second} block",
)
"""Forms of texts that say what must not be."""

QUANTITIES = (
    "all {first} blocks {words} the {second} block",
    "every {first} block {words} the {second} block",
    "each {first} block {words} a {second} block",
    "both {first} blocks {words} the {second} block",
    "two {first} blocks {words} the {second} block",
    "3 {first} blocks {words} the {second} block",
    "exactly two {first} blocks {words} the {second} block",
    "at most one {first} block {words} the {second} block",
    "only one {first} block {words} the {second} block",
    "no more than one {first} block {words} the {second} block",
    "a couple of {first} blocks {words} the {second} block",
    "a dozen {first} blocks {words} the {second} block",
    "several {first} blocks {words} the {second} block",
    "many {first} blocks {words} the {second} block",
    "most of the {first} blocks {words} the {second} block",
    "half of the {first} blocks {words} the {second} block",
    "none of the {first} blocks {words} the {second} block",
    "as many {first} blocks as possible {words} the {second} block",
)
"""Forms of texts that say how many."""

RARER = (
    "the {first} block may be anywhere save {words} the {second} block",
    "I am against the {first} block {words} the {second} block",
    "see to it that the {first} block stops being {words} the {second} block",
    "ban the {first} block {words} the {second} block",
    "zero {first} blocks {words} the {second} block",
    "more than one {first} block {words} the {second} block",
    "lots of {first} blocks {words} the {second} block",
    "twelve {first} blocks {words} the {second} block",
    "numerous {first} blocks {words} the {second} block",
    "plenty of {first} blocks {words} the {second} block",
    "it would be bad to have the {first} block {words} the {second} block",
    "it is a mistake to put the {first} block {words} the {second} block",
    "beware of putting the {first} block {words} the {second} block",
    "the {first} block leaves its place {words} the {second} block",
    "clear the {first} block {words} the {second} block",
    "the {first} block is hardly {words} the {second} block",
    "the {first} block would rather not sit {words} the {second} block",
    "anything except a {first} block {words} the {second} block",
    "excluding the {first} block {words} the {second} block",
    "if the {first} block is {words} the {second} block, undo it",
    "the {first} block mustn't sit {words} the {second} block",
    "the {first} block won't be {words} the {second} block",
    "least of all put the {first} block {words} the {second} block",
    "end the {first} block being {words} the {second} block",
    "cease putting the {first} block {words} the {second} block",
    "forget about the {first} block {words} the {second} block",
    "the {first} block used to be {words} the {second} block",
)
"""Forms of both kinds, chosen after words of the others were made to prevent a question; none was added for these."""

FORMS = (*NEGATIONS, *QUANTITIES, *RARER)

_PAIRS = (("yellow", "green"), ("green", "yellow"), ("red", "blue"))
"""Blocks of the texts; the language policies of the benchmark know the first two."""


def texts(form: str) -> tuple[str, ...]:
    """Returns the texts of a form: one for each relation of each pair, none twice."""
    filled = (
        form.format(first=first, words=words, second=second)
        for words in CANONICAL_WORDINGS.values()
        for first, second in _PAIRS
    )
    return tuple(dict.fromkeys(filled))
