"""The decisions of a model of criteria: for each goal caption, which of it and its rivals it prefers."""

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freerein.criteria import Criterion
from freerein.criterion_text import Claim, CriterionGrammar
from freerein_reward.methods.criterion_captions.captions import NO_NOUN
from freerein_reward.methods.criterion_captions.network import MAX_NOUNS, STATEMENTS


def goal_scores(
    scores: Tensor, tuples: npt.NDArray[np.int64], grammar: CriterionGrammar
) -> Iterator[tuple[Criterion, npt.NDArray[np.int64], Tensor]]:
    """Yields each criterion of a model, the numbers of its tuples (t,), and the scores of goals and rivals (N, t, K).

    `scores` are those of all captions, (N, T, statements), of tuples int64 (T, 3). The goal's score is the first.
    """
    is_pair = tuples[:, -1] == NO_NOUN
    for criterion in grammar.criteria:
        rivals = [(Claim.HOLDS, name) for name in criterion.excludes]
        said = [(Claim.HOLDS, criterion.name), *rivals, (Claim.FAILS, criterion.name), (Claim.MISSING, "")]
        of_size = np.flatnonzero(is_pair if criterion.nouns < MAX_NOUNS else ~is_pair)
        yield criterion, of_size, scores[:, of_size][..., [STATEMENTS.index(each) for each in said]]


def answer_confidence(scores: Tensor, tuples: npt.NDArray[np.int64], grammar: CriterionGrammar) -> Tensor:
    """Returns the probability of what wins among each goal and its rivals, float32 (N * answers,), image by image."""
    answers = [among.softmax(dim=2).amax(dim=2) for _, _, among in goal_scores(scores, tuples, grammar)]
    return torch.cat(answers, dim=1).flatten()


def rewards(among: Tensor) -> Tensor:
    """Returns whether goals win against all rivals, bool (N, t), of scores as of `goal_scores`."""
    return among[..., 0] > among[..., 1:].amax(dim=-1)
