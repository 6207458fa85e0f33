"""Rewards in scenes of two and of four blocks under each condition, against true relations.

An answer is about one scene and one ordered pair of blocks: which of the five relations a model prefers. A trial is an
episode of two scenes.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from experiments.robustness.confidence import Answers
from experiments.robustness.draw import Drawn, Scenes, open_or_draw
from experiments.robustness.reward_model import EPSILON, PHRASES, open_grounding
from experiments.robustness.worlds import BLOCKS, CAMERA, NOMINAL, SCATTERED, conditions
from experiments.workbench.results import Outcome, Sample
from freerein.relations import SpatialRelation
from freerein_reward.methods.relation_captions.caption_dataset import (
    ABSENT,
    CAPTIONS,
    flatten_pairs,
    ordered_pairs,
    pair_captions,
)
from freerein_reward.model import DualEncoderModel
from freerein_reward.model.phrase_relations import pairwise_relations
from freerein_sim.worlds.tasks import tasks

Labels = npt.NDArray[np.int64]

ACCURACY, BALANCED, ABSENT_REWARDED = "accuracy", "balanced_accuracy", "absent_rewarded"
_COUNT, _SEED = 150, 1_000_002
_DECIMALS = 6
_SHOWN = 0.5


def scene_specs() -> dict[tuple[str, str], Scenes]:
    """Returns the scenes by condition and number of blocks."""
    return {(each, blocks): Scenes(_COUNT, _SEED, blocks, each) for each in conditions(SCATTERED) for blocks in BLOCKS}


def nominal_specs() -> list[Scenes]:
    """Returns the nominal scenes."""
    return [spec for (condition, _), spec in scene_specs().items() if condition == NOMINAL]


@dataclass(frozen=True, eq=False)
class Judged:
    """A model's answers about M scenes and P ordered pairs.

    Attributes:
        relation: int64 (M, P), the relation that it prefers.
        is_rewarded: bool (M, P), whether the goal of that relation is rewarded.
    """

    relation: Labels
    is_rewarded: npt.NDArray[np.bool_]


def true_relations(states: npt.NDArray[np.float64]) -> Labels:
    """Returns the relation of each ordered pair in states (M, S), int64 (M, P); `ABSENT` where one is not on show."""
    predicates = [each for each in tasks()[SCATTERED].predicates if each.group]
    holds = np.stack([each.holds(states[:, None])[:, 0] for each in predicates], axis=1)
    holds = holds.reshape(len(states), -1, len(SpatialRelation))  # (M, P, 5)
    relations: Labels = np.where(holds.any(axis=2), holds.argmax(axis=2), ABSENT)
    return relations


def evaluate(model: DualEncoderModel, work: Path) -> Outcome:
    """Returns accuracies and rewards of absent blocks."""
    return Outcome({}, _judge_all(lambda drawn: judge(model, drawn)[0], work))


def judge(model: DualEncoderModel, drawn: Drawn) -> tuple[Judged, Answers]:
    """Returns what a model prefers and rewards, and its answers about each pair, absence among them."""
    texts, _ = model.embed_texts(pair_captions(PHRASES, ordered_pairs(len(PHRASES))))
    seen = model.embed_images({CAMERA: drawn.seen["frames"]})
    similarities = (seen.vectors @ texts.T).clip(-1, 1)  # (M, P * CAPTIONS)
    similarities = similarities.reshape(len(seen.vectors), -1, CAPTIONS)
    relation = similarities[..., :ABSENT].argmax(axis=2)
    judged = Judged(relation, similarities[..., :ABSENT].max(axis=2) > similarities[..., ABSENT])
    return judged, _answers(model, drawn, similarities, seen.distances)


def evaluate_captions(work: Path) -> Outcome:
    """Returns the figures of table 4.1's rule at the places where the grounding model finds the blocks."""
    grounding = open_grounding()

    def judge(drawn: Drawn) -> Judged:
        found = grounding.ground(drawn.seen["frames"], PHRASES)
        everywhere = np.ones(found.x.shape, np.bool_)
        relation = flatten_pairs(pairwise_relations(found.x, found.y, everywhere, epsilon=EPSILON))
        shown = found.presence >= _SHOWN
        first, second = ordered_pairs(len(PHRASES)).T
        return Judged(relation, shown[:, first] & shown[:, second])

    return Outcome({}, _judge_all(judge, work))


def evaluate_majority(work: Path) -> Outcome:
    """Returns the figures of the commonest relation, which it knows, for all pairs of all scenes."""
    return Outcome({}, _judge_all(lambda drawn: _constant(_commonest(truth_of(drawn)), truth_of(drawn)), work))


def evaluate_word_blind(work: Path) -> Outcome:
    """Returns the figures of the commonest relation of each scene, which it knows, whatever pair is asked for."""

    def judge(drawn: Drawn) -> Judged:
        truth = truth_of(drawn)
        relation = np.array([np.full(len(scene), _commonest(scene)) for scene in truth])
        return Judged(relation, np.ones(truth.shape, np.bool_))

    return Outcome({}, _judge_all(judge, work))


def score(judged: Judged, truth: Labels, lengths: Labels) -> Iterator[tuple[str, Sample]]:
    """Yields samples by name, a trial for each of `lengths`, int64 (n,), which sum to M.

    Balanced accuracy is the accuracy of answers weighted by how rare their true relation is.
    """
    is_shown = truth != ABSENT
    right = is_shown & (judged.relation == truth)
    counts = np.bincount(truth[is_shown], minlength=ABSENT)
    weights = np.divide(counts.sum(), counts, out=np.zeros(ABSENT), where=counts > 0)
    weight = np.where(is_shown, weights[np.minimum(truth, ABSENT - 1)], 0)  # (M, P)
    yield ACCURACY, _by_trial(right, is_shown, lengths)
    yield BALANCED, _by_trial(right * weight, weight, lengths)
    if not is_shown.all():
        yield ABSENT_REWARDED, _by_trial(judged.is_rewarded & ~is_shown, ~is_shown, lengths)


def _judge_all(judge: Callable[[Drawn], Judged], work: Path) -> dict[str, Sample]:
    samples = {}
    for (condition, blocks), spec in scene_specs().items():
        drawn = open_or_draw(spec, work)
        for name, sample in score(judge(drawn), truth_of(drawn), drawn.seen["lengths"]):
            samples[f"{condition}.{blocks}.{name}"] = sample
    return samples


def _by_trial(totals: npt.NDArray[np.generic], counts: npt.NDArray[np.generic], lengths: Labels) -> Sample:
    starts = np.cumsum(lengths) - lengths
    sums = [np.add.reduceat(np.asarray(each, np.float64).sum(axis=1), starts) for each in (totals, counts)]
    return Sample(*(np.round(each, _DECIMALS).tolist() for each in sums))


def _answers(
    model: DualEncoderModel,
    drawn: Drawn,
    similarities: npt.NDArray[np.float32],
    distances: npt.NDArray[np.float32],
) -> Answers:
    """Returns the answers about each pair, absence among them; those of an episode are one trial."""
    truth, scaled = truth_of(drawn), model.network.temperature(torch.from_numpy(similarities))
    scores = [model.in_distribution(distances, np.ascontiguousarray(each)) for each in similarities.swapaxes(0, 1)]
    lengths = drawn.seen["lengths"]
    return Answers(
        right=(similarities.argmax(axis=2) == truth).ravel(),
        confidence=scaled.softmax(dim=2).amax(dim=2).detach().numpy().ravel(),
        score=np.stack(scores, axis=1).ravel(),
        trial=np.repeat(np.repeat(np.arange(len(lengths)), lengths), truth.shape[1]),
    )


def truth_of(drawn: Drawn) -> Labels:
    """Returns the relation of each ordered pair in scenes, int64 (M, P); see `true_relations`."""
    return true_relations(drawn.truth["states"])


def _constant(relation: int, truth: Labels) -> Judged:
    return Judged(np.full(truth.shape, relation), np.ones(truth.shape, np.bool_))


def _commonest(truth: Labels) -> int:
    """Returns the commonest relation, the first of equals."""
    return int(np.bincount(truth[truth != ABSENT].ravel(), minlength=1).argmax())
