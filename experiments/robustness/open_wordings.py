"""Classes of wordings that the grammar of goal texts was not made for, and whether it understands them.

A text is understood where it is read as what it means, or asked back with a sentence that means it.
"""

from collections.abc import Mapping
from types import MappingProxyType

from experiments.workbench.results import Sample
from freerein.goal_text import Grammar
from freerein.relations import SpatialRelation, caption

WHOLE, WRONG = "open.whole", "open.wrong"

CLASSES: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {
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
)
"""Texts by class, and what each means, in the form of `meant`; empty where it does not say."""

_RELATIONS = MappingProxyType(
    {
        "left": SpatialRelation.LEFT_OF,
        "right": SpatialRelation.RIGHT_OF,
        "on": SpatialRelation.ON_TOP_OF,
        "below": SpatialRelation.BELOW,
        "apart": SpatialRelation.APART_FROM,
    }
)


def samples(grammar: Grammar) -> dict[str, Sample]:
    """Returns the share of classes understood whole, a trial each, and of texts understood wrongly."""
    right, wrong, counts = [], [], []
    for texts in CLASSES.values():
        found = {text: understood(grammar, text) for text in texts}
        right.append(int(all(found[text] == meant(said) for text, said in texts.items())))
        wrong.append(sum(found[text] not in ("", meant(said)) for text, said in texts.items()))
        counts.append(len(texts))
    return {WHOLE: Sample(right, [1] * len(right)), WRONG: Sample(wrong, counts)}


def meant(said: str) -> str:
    """Returns the caption of a short form such as `red on yellow`; empty for an empty one."""
    first, relation, second = said.split() or ("", "", "")
    return said and caption(f"a {first} block", _RELATIONS[relation], f"a {second} block")


def understood(grammar: Grammar, text: str) -> str:
    """Returns the caption that a text is read as or asked back with; empty for neither."""
    read = grammar.read(text)
    return read.text if read.statement else read.did_you_mean
