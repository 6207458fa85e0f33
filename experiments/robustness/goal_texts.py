"""What the readers of goal texts make of wordings that they were not made for, and of texts that are no goals.

The readers are the grammar of the reward model that ships, and those of two language policies: one that was taught the
two tasks of the arm `language`, and one that was taught every caption.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path

import numpy as np

from experiments.robustness import forbidden_texts, open_wordings
from experiments.robustness.language import SIDES
from experiments.robustness.reward_model import COLOURS, PHRASES
from experiments.workbench.results import Outcome, Sample
from freerein.goal_text import Grammar
from freerein.model_store import ModelStore
from freerein.relations import SpatialRelation, caption
from freerein_imitation.model.known_texts import KnownTexts
from freerein_reward.model import load_reward_model
from freerein_sim.worlds.tasks import tasks

TEXTS = "texts"
"""Method of the arm."""

REWARD, TWO_TASKS, CAPTIONS = "reward", "two-tasks", "captions"
POLICIES = (TWO_TASKS, CAPTIONS)
READERS = (REWARD, *POLICIES)
FOLLOWED, ASKED_BACK, NAMED = "followed", "asked-back", "named"

_REWARD_MODELS = Path("models/reward")
_BLOCKS = frozenset((*COLOURS, "block", "blocks"))


@dataclass(frozen=True)
class Reading:
    """A reader's answer to a text.

    Attributes:
        is_followed: Whether it is a goal: a policy acts, or a reward is given.
        is_asked_back: Whether it is refused with the nearest readable sentence.
        is_named: Whether it is refused with unknown words, others than those for blocks.
    """

    is_followed: bool
    is_asked_back: bool
    is_named: bool


def figure(reader: str, name: str) -> str:
    """Returns the name of a reader's figure on forbidden texts."""
    return f"forbidden.{reader}.{name}"


def evaluate() -> Outcome:
    """Returns the shares of open wordings that are understood, by class, and of forbidden texts, by form."""
    grammar = shipped_grammar()
    samples = open_wordings.samples(grammar)
    for reader, read in readers(grammar).items():
        samples |= _forbidden(reader, read)
    return Outcome({}, samples)


def shipped_grammar() -> Grammar:
    """Returns the grammar of the reward model that ships."""
    return load_reward_model(_REWARD_MODELS / "default" / reward_version(), "cpu").grammar


def reward_version() -> str:
    """Returns the version of the reward model that ships."""
    return ModelStore(_REWARD_MODELS).active_version("default")


def readers(grammar: Grammar) -> Mapping[str, Callable[[str], Reading]]:
    """Returns the readers by name; each reads one text."""
    pairs = list(permutations(PHRASES, 2))
    captions = [caption(first, relation, second) for first, second in pairs for relation in SpatialRelation]
    return {
        REWARD: lambda text: _read(grammar, text),
        TWO_TASKS: _reader_of_policy([tasks()[task].goal_text for task in SIDES]),
        CAPTIONS: _reader_of_policy(captions),
    }


def _read(grammar: Grammar, text: str) -> Reading:
    read = grammar.read(text)
    return Reading(read.statement is not None, bool(read.did_you_mean), not _BLOCKS.issuperset(read.unknown))


def _reader_of_policy(training_texts: list[str]) -> Callable[[str], Reading]:
    known = KnownTexts(training_texts)

    def read_text(text: str) -> Reading:
        read = known.read(text)
        is_followed = read.training_text is not None or read.caption is not None
        return Reading(is_followed, bool(read.did_you_mean), not _BLOCKS.issuperset(read.unknown))

    return read_text


def _forbidden(reader: str, read: Callable[[str], Reading]) -> dict[str, Sample]:
    """Returns shares of forbidden texts, of those asked back among the rarer forms; a trial is a form."""
    forms = {form: [read(text) for text in forbidden_texts.texts(form)] for form in forbidden_texts.FORMS}
    rarer = [forms[form] for form in forbidden_texts.RARER]
    flags = {
        FOLLOWED: [[each.is_followed for each in form] for form in forms.values()],
        ASKED_BACK: [[each.is_asked_back for each in form] for form in rarer],
        NAMED: [[each.is_named for each in form] for form in forms.values()],
    }
    return {figure(reader, name): Sample.of_flags(map(np.array, each)) for name, each in flags.items()}
