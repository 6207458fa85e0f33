"""Codes of goal texts, as a network takes them."""

from collections.abc import Sequence
from typing import Literal

import torch
from torch import Tensor

from freerein.goal_text import Grammar
from freerein.relations import SpatialRelation
from freerein_imitation.methods.language.texts.goal_text_reader import GoalTextReader
from freerein_imitation.methods.language.texts.text_encoder import TextEncoder

TextCode = Literal["statement", "sentence"]
"""Kinds of text codes; see `LanguageConfig.text_code`."""

RELATIONS = tuple(SpatialRelation)
PAIR = 2
"""Numbers of a statement before its relation: the phrases that it names."""


def encode_text(
    text: str, reader: GoalTextReader, encoder: TextEncoder, *, text_code: TextCode, phrases: Sequence[str] = ()
) -> Tensor:
    """Returns a text's code, float32 (reader.code_size + statement_size(phrases),).

    Args:
        text: The text.
        reader: Reads it.
        encoder: The text encoder.
        text_code: Kind of the reader's part.
        phrases: Noun phrases that an object encoder locates; without one a code has the reader's part alone.
    """
    code = reader.encode(text, encoder) if text_code == "statement" else reader.encode_sentence(text, encoder)
    return torch.cat([code, _statement(text, phrases)]) if phrases else code


def statement_size(phrases: Sequence[str]) -> int:
    """Returns the numbers of a statement about phrases that an object encoder locates; 0 without one."""
    return PAIR + len(RELATIONS) if phrases else 0


def _statement(text: str, phrases: Sequence[str]) -> Tensor:
    """Returns the numbers of the two phrases that a text names, and the one-hot code of its relation.

    Of a text that relates no two of them all numbers are 0.
    """
    said = Grammar(phrases, phrases).read(text).statement
    if said is None:
        return torch.zeros(statement_size(phrases))
    relation = [float(each is said.relation) for each in RELATIONS]
    return torch.tensor([phrases.index(said.first), phrases.index(said.second), *relation])
