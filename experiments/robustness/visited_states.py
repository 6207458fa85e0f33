"""The reward on states that PPO's policies visit, and what these policies achieve under each condition."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import numpy as np
import numpy.typing as npt

from experiments.robustness import wordings
from experiments.robustness.draw import Drawn, Rollouts, open_or_draw
from experiments.robustness.worlds import CAMERA, NOMINAL, SCATTERED, conditions
from experiments.workbench.results import Outcome, Sample
from freerein.learning import model_files
from freerein.learning.actor_critic.policy_files import NAMES
from freerein_reward.model import DualEncoderModel
from freerein_sim.worlds.tasks import tasks

METHOD, ALL = "visited", "all"
"""The reward on states of all teachers of chapter 4: figures of all together, and by relation."""

RELATIONS = ("left-of", "right-of", "on-top-of")
PRECISION, RECALL, RETURN, SHARE_TRUE = "precision", "recall", "return", "true"
FALSE_POSITIVE_RATE, PRECISION_AT_SHARE = "false-positive-rate", "precision-at-0.4"
"""What follows from the others; see `derived`."""

_SHARE = 0.4

Flags = npt.NDArray[np.bool_]

_NOMINAL_EPISODES, _EPISODES, _SEED = 30, 12, 1_000_003


@dataclass(frozen=True)
class StoredPolicy:
    """A policy of the orchestrator on disk: its task, its folder, and the sha256 of its weights."""

    task: str
    folder: str
    sha256: str

    @property
    def name(self) -> str:
        """Its name among the models."""
        return Path(self.folder).parent.name


def stored_policies(folder: Path) -> tuple[StoredPolicy, ...]:
    """Returns the policies in a folder of models, by name: one for each task."""
    found = []
    for path in sorted(folder.glob(f"*/*/{NAMES.card}")):
        card = model_files.read_card(path.parent, names=NAMES)
        found.append(StoredPolicy(card["task"], str(path.parent), card["sha256"]))
    return tuple(found)


def evaluate(model: DualEncoderModel, policy: StoredPolicy, work: Path) -> Outcome:
    """Returns precision and recall of the reward for the task's goal text, by true relations; a trial is an episode."""
    drawn = open_or_draw(rollouts(policy, NOMINAL), work)
    holds = _holds(drawn, policy.task)
    seen = model.embed_images({CAMERA: drawn.seen["frames"]})
    is_rewarded = wordings.rewards(model, seen, model.grammar.read(tasks()[policy.task].goal_text))
    return Outcome(
        {},
        {
            PRECISION: _share(is_rewarded & holds, is_rewarded, drawn),
            RECALL: _share(is_rewarded & holds, holds, drawn),
            SHARE_TRUE: _share(holds, np.ones(len(holds), np.bool_), drawn),
        },
    )


def evaluate_all(model: DualEncoderModel, policies: Sequence[StoredPolicy], work: Path) -> Outcome:
    """Returns the figures of `evaluate`, and what follows from them, over all policies and over those of a relation."""
    found = {each.task: evaluate(model, each, work).samples for each in policies}
    samples: dict[str, Sample] = {}
    for group in (ALL, *RELATIONS):
        parts = [each for task, each in found.items() if group == ALL or group in task]
        joined = {name: join([each[name] for each in parts]) for name in (PRECISION, RECALL, SHARE_TRUE)}
        samples |= {of_group(group, name): sample for name, sample in (joined | derived(joined)).items()}
    return Outcome({}, samples)


def of_group(group: str, figure: str) -> str:
    """Returns the name of a figure over a relation's policies, or over `ALL`."""
    return f"{group}.{figure}"


def join(parts: Sequence[Sample]) -> Sample:
    """Returns the trials of several samples as one."""
    totals, counts = ([*chain.from_iterable(each)] for each in zip(*((p.totals, p.counts) for p in parts), strict=True))
    return Sample(totals, counts)


def derived(samples: Mapping[str, Sample]) -> dict[str, Sample]:
    """Returns the false positive rate, and the precision as it were if the goal held in 40 % of the states.

    Precision falls as the goal holds less often; policies that do well hide false positives. For it, states in which
    the goal holds and others are weighed so that the former are 40 %; these weights are held fixed in intervals.

    Args:
        samples: `PRECISION`, `RECALL` and `SHARE_TRUE` of the same episodes.
    """
    rewarded, (right, holds) = samples[PRECISION].counts, (samples[RECALL].totals, samples[RECALL].counts)
    steps = samples[SHARE_TRUE].counts
    wrong = np.subtract(rewarded, right) * (np.sum(right) > 0)  # where nothing is rewarded, counts are no counts
    others = np.subtract(steps, holds)
    weighed = np.multiply(right, _SHARE / np.sum(holds)), wrong * ((1 - _SHARE) / np.sum(others))
    return {
        FALSE_POSITIVE_RATE: Sample(wrong.tolist(), others.tolist()),
        PRECISION_AT_SHARE: Sample(weighed[0].tolist(), np.add(*weighed).tolist()),
    }


def evaluate_policy(policy: StoredPolicy, work: Path) -> Outcome:
    """Returns the return of the oracle under each condition; a trial is an episode."""
    samples = {}
    for condition in conditions(policy.task):
        returns = [each.sum() for each in open_or_draw(rollouts(policy, condition), work).by_trajectory("rewards")]
        samples[f"{condition}.{RETURN}"] = Sample([float(each) for each in returns], [1] * len(returns))
    return Outcome({}, samples)


def rollouts(policy: StoredPolicy, condition: str) -> Rollouts:
    """Returns the spec of a policy's episodes."""
    count = _NOMINAL_EPISODES if condition == NOMINAL else _EPISODES
    return Rollouts(count, _SEED, policy.task, policy.folder, policy.sha256, condition)


def _holds(drawn: Drawn, task: str) -> Flags:
    """Returns whether the task's relation holds, bool (N,), whether its blocks are at rest or held."""
    text = tasks()[task].goal_text
    (predicate,) = (each for each in tasks()[SCATTERED].predicates if each.text == text)
    return predicate.holds(drawn.truth["states"][:, None])[:, 0]


def _share(totals: Flags, counts: Flags, drawn: Drawn) -> Sample:
    """Returns the share of some steps; 0 where there are none, as of a reward that is never given."""
    ends = np.cumsum(drawn.seen["lengths"])[:-1]
    sums = [[int(part.sum()) for part in np.split(each, ends)] for each in (totals, counts)]
    return Sample(sums[0], sums[1] if any(sums[1]) else [1] * len(sums[1]))
