"""Reads goal texts as statements that two noun phrases stand in a relation, by tagging the tokens of a text encoder.

A mean of token states hardly says who is left of whom; the states of single tokens do. A reading is encoded so that
texts with one meaning have nearly one code: `a red cube is left of the green one` as `put the red block to the left of
a green block`. A converse, `the green block to the right of a red one`, differs in which object is to move, and in that
alone. What a converse means is given here, not learned.
"""

from enum import IntEnum

import torch
from torch import Tensor, nn
from torch.nn import functional

from freerein_imitation.methods.language.texts.text_encoder import TextEncoder


class Tag(IntEnum):
    """What a token belongs to: nothing that matters, one of the two noun phrases, or a relation of first to second."""

    NOTHING = 0
    FIRST = 1
    SECOND = 2
    LEFT_OF = 3
    RIGHT_OF = 4
    ON_TOP_OF = 5
    BELOW = 6
    APART_FROM = 7


_PLACES = {
    Tag.LEFT_OF: (0, 1),
    Tag.RIGHT_OF: (1, 0),
    Tag.ON_TOP_OF: (2, 3),
    Tag.BELOW: (3, 2),
    Tag.APART_FROM: (4, 4),
}
"""Parts of a code that describe the first and the second phrase."""

_MOVED = 5
_MOVED_WEIGHT = 0.5
"""Of the first phrase, whose object is the one to move. It weighs less than the relation: where goals of training never
differ in it, as in one task and its mirror image, a converse has the very code of the goal."""

_OTHER_TEXT = 6
_PARTS = 7
_HIDDEN = 64


class GoalTextReader(nn.Module):
    """Tags tokens by two dense layers, trained on text alone; it takes no part in learning to act.

    Args:
        size: Numbers of a token's state.

    Attributes:
        code_size: Numbers of a code.
    """

    mean: Tensor
    std: Tensor

    def __init__(self, size: int) -> None:
        super().__init__()
        self.code_size = _PARTS * size
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("std", torch.ones(size))
        self.hidden = nn.Linear(size, _HIDDEN)
        self.tags = nn.Linear(_HIDDEN, len(Tag))

    def forward(self, states: Tensor) -> Tensor:
        """Returns logits of tags, float32 (N, tags), of tokens' states, float32 (N, size)."""
        tags: Tensor = self.tags(functional.relu(self.hidden((states - self.mean) / self.std)))
        return tags

    @torch.no_grad()
    def encode(self, text: str, encoder: TextEncoder) -> Tensor:
        """Returns a text's code, float32 (code_size,).

        A statement's code holds the sum of each phrase's word embeddings, in the place that the relation gives it: the
        left one first, say; and that of the first phrase once more. The code of any other text is its sentence
        embedding, in a place of its own.
        """
        tokens = encoder.tokenize(text)
        probabilities = self(encoder.token_states(tokens)).softmax(dim=1)  # (L, tags)
        tags = probabilities.argmax(dim=1)  # (L,)
        if not {Tag.FIRST, Tag.SECOND} <= set(tags.tolist()) or int(tags.max()) < Tag.LEFT_OF:
            return self.encode_sentence(text, encoder)
        code = torch.zeros(_PARTS, encoder.size)
        relation = Tag(Tag.LEFT_OF + int(probabilities[:, Tag.LEFT_OF :].sum(dim=0).argmax()))
        words = encoder.word_embeddings(tokens)  # (L, size)
        for tag, place in zip((Tag.FIRST, Tag.SECOND), _PLACES[relation], strict=True):
            code[place] += words[tags == tag].sum(dim=0)
        code[_MOVED] = _MOVED_WEIGHT * words[tags == Tag.FIRST].sum(dim=0)
        return code.flatten()

    @torch.no_grad()
    def encode_sentence(self, text: str, encoder: TextEncoder) -> Tensor:
        """Returns the code of a text that is read as no statement, float32 (code_size,): its sentence embedding."""
        code = torch.zeros(_PARTS, encoder.size)
        code[_OTHER_TEXT] = encoder.embed(encoder.tokenize(text))
        return code.flatten()
