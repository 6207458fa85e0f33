"""Self-training inside the tag set: labels by Viterbi from a frozen copy of the network, the teacher of a round.

Labels are found when a trajectory is used: by the teacher's probabilities within the trajectory's tags, with a cost for
each switch (set-constrained Viterbi, Li and Todorovic, 2020, arXiv 2002.11925; expectation maximisation over
instances, Luo et al., 2020). With a weight for action evidence, a skill is also known by what it does (Shiarlis et
al., "TACO", 2018, arXiv 1803.01840, without its order): an action model of each skill, fitted to the teacher's labels
on the teacher's features, adds its log posterior. A teacher is plain tensors, and a part of the training state.
"""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn

from freerein.learning import weights
from freerein.learning.train_state import TrainState, tensors_under
from freerein_segmentation.model import Context, ModelSpec, SegmentationNetwork
from freerein_segmentation.model.action_model import ActionModel
from freerein_segmentation.objectives.labels import label_cross_entropy
from freerein_segmentation.objectives.set_likelihood import set_likelihood
from freerein_segmentation.training.batches import TrajectoryBatch
from freerein_segmentation.training.confidence import CONFIDENCE
from freerein_segmentation.training.viterbi import viterbi

if TYPE_CHECKING:
    from freerein_segmentation.training.config import SegmentationConfig
    from freerein_segmentation.training.learner import SegmentationLearner, TagStage

_ACTION_TRAJECTORIES = 400
"""Most trajectories that an action model is fitted to."""

_LEAST_EVIDENCE = -5.0
"""Least log posterior of a skill given the action, in nats: one surprising action must not outweigh the network."""

_STEPS, _BATCH, _LR = 300, 256, 3e-3

_LOG_SHARE = "log_share"


def self_training(learner: "SegmentationLearner") -> tuple["TagStage", ...]:
    """Returns a stage of the objective, then rounds.

    As a round begins, the network is copied: the teacher, which sees as much of the future as the network did until
    then. In the round the network learns the labels that the teacher finds.
    """
    stages, config = [learner.before_final()], learner.config
    steps = config.steps - stages[0].steps
    rounds = min(config.rounds, steps)
    ends = [steps * each // rounds for each in range(rounds + 1)]
    for start, end in pairwise(ends):
        teaching = learner, stages[-1].context
        begin, loss = partial(_begin_round, *teaching), partial(_label_loss, *teaching)
        name = f"round-{len(stages)}"
        stages.append(learner.stage(name, end - start, set_likelihood, context=config.context, begin=begin, loss=loss))
    return tuple(stages)


def _begin_round(
    learner: "SegmentationLearner", context: Context, state: TrainState[SegmentationNetwork]
) -> TrainState[SegmentationNetwork]:
    """Returns a state that carries its network as the teacher, with an action model of the teacher's labels."""
    if CONFIDENCE not in state.carried:
        state = learner.carry_confidence(state, context=context)
    tensors = {f"network.{name}": tensor.clone() for name, tensor in state.network.state_dict().items()}
    if context != learner.spec.context:
        tensors[_LOG_SHARE] = _log_share(learner)
    teacher = Teacher.load(tensors, learner.spec, learner.config, context=context)
    items = torch.randperm(learner.size, generator=state.generator)[:_ACTION_TRAJECTORIES].tolist()
    if learner.config.action_evidence:
        size = learner.config.batch_size
        batches = (learner.batch(items[at : at + size], state.generator) for at in range(0, len(items), size))
        labelled = _labelled(teacher, batches)
        teacher.actions = fit_action_model(*labelled, spec=learner.spec, generator=state.generator)
    return replace(state, carried={**teacher.state_dict(), CONFIDENCE: state.carried[CONFIDENCE]})


def _label_loss(
    learner: "SegmentationLearner",
    context: Context,
    state: TrainState[SegmentationNetwork],
    batch: TrajectoryBatch,
    scores: Tensor,
    _mask: Tensor,
) -> Tensor:
    """Returns the cross-entropy of the teacher's labels, float (B,)."""
    kept = {name: tensor.to(learner.device) for name, tensor in state.carried.items() if name != CONFIDENCE}
    teacher = Teacher.load(kept, learner.spec, learner.config, context=context)
    return label_cross_entropy(scores, teacher.label(batch))


def _log_share(learner: "SegmentationLearner") -> Tensor:
    """Returns the logarithm of the share of training trajectories that have each skill, float32 (K,).

    It is for a teacher that sees less of the future than the network that learns its labels. By Bayes' rule,
    P(y_t | x, tags) is as P(y_t | x) P(tags | y_t, x). What the teacher cannot tell from x yet is as likely as it is
    among the trajectories with the skill: each has one over their number.
    """
    counts = Counter(skill for skills in learner.training.skills for skill in skills)
    shares = [max(1, counts[skill]) / learner.size for skill in learner.spec.skills]
    return torch.tensor(shares, device=learner.device).log()


class Teacher(nn.Module):
    """A frozen network that labels trajectories.

    Args:
        network: The network.
        config: Has the cost of a switch, and the weight of the action model's log posterior.
        context: Future timesteps that the network sees.
        actions: The action model; None for a teacher that does not look at actions' evidence.
        log_share: Logarithm of each skill's share of trajectories, float (K,), which is taken off its scores.
    """

    log_share: Tensor | None

    def __init__(
        self,
        network: SegmentationNetwork,
        config: "SegmentationConfig",
        *,
        context: Context,
        actions: ActionModel | None = None,
        log_share: Tensor | None = None,
    ) -> None:
        super().__init__()
        self.network, self.actions, self._config, self._context = network, actions, config, context
        self.register_buffer(_LOG_SHARE, log_share)

    @classmethod
    def load(
        cls, tensors: Mapping[str, Tensor], spec: ModelSpec, config: "SegmentationConfig", *, context: Context
    ) -> "Teacher":
        """Returns the teacher with some state, on its device."""
        with torch.device("meta"):  # allocates no weights
            network = SegmentationNetwork(spec)
            actions = _action_model(spec) if tensors_under("actions.", tensors) else None
        teacher = cls(network, config, context=context, actions=actions, log_share=tensors.get(_LOG_SHARE))
        teacher.load_state_dict(tensors, assign=True)
        return teacher.eval()

    @torch.no_grad()
    def label(self, batch: TrajectoryBatch) -> Tensor:
        """Returns labels, int64 (B, T), `NO_SKILL` in the padding."""
        features = self.network.features(batch.frames, batch.actions)  # (N, D)
        scores, mask = self.network.score_batch(features, batch.lengths, context=self._context)
        emissions = scores.log_softmax(dim=2)
        if self.log_share is not None:
            emissions = emissions - self.log_share
        if self.actions is not None:
            log_likelihood = self.actions(
                features[:, : self.network.image.size], self.network.spec.scaled(batch.actions)
            )  # (N, K)
            added = torch.zeros_like(emissions)
            added[mask] = action_posterior(log_likelihood)
            emissions = emissions + self._config.action_evidence * added
        return viterbi(emissions, mask, batch.tags, switching_cost=self._config.switching_cost)


def action_posterior(log_likelihood: Tensor) -> Tensor:
    """Returns log P(c | a_t, x_t) with equal priors, float (N, K), bounded from below; of log pi(a_t | x_t, c)."""
    return log_likelihood.log_softmax(dim=1).clamp(min=_LEAST_EVIDENCE)


def fit_action_model(
    features: Tensor, actions: Tensor, labels: Tensor, *, spec: ModelSpec, generator: torch.Generator
) -> ActionModel:
    """Returns an action model of labels, int64 (N,), given a network's features of frames (N, D) and scaled actions."""
    model = _action_model(spec)
    weights.initialise(model, generator=generator)
    model.to(features.device).standardise("feature", features)
    if not spec.action.choices:
        model.standardise("action", actions)
    optimiser = torch.optim.Adam(model.parameters(), _LR, fused=True)
    for _ in range(_STEPS):
        rows = torch.randint(len(features), (_BATCH,), generator=generator).to(features.device)
        optimiser.zero_grad()
        with torch.enable_grad():
            loss = -model(features[rows], actions[rows]).gather(1, labels[rows, None]).mean()
            loss.backward()
        optimiser.step()
    return model.requires_grad_(requires_grad=False)


def _labelled(teacher: Teacher, batches: Iterable[TrajectoryBatch]) -> tuple[Tensor, Tensor, Tensor]:
    """Returns a teacher's features of frames (N, D), scaled actions (N, A), and its labels, int64 (N,)."""
    features, actions, labels = [], [], []
    for batch in batches:
        with torch.no_grad():
            features.append(teacher.network.image(batch.frames))
        actions.append(teacher.network.spec.scaled(batch.actions))
        found = teacher.label(batch)
        labels.append(found[found >= 0])
    return torch.cat(features), torch.cat(actions), torch.cat(labels)


def _action_model(spec: ModelSpec) -> ActionModel:
    return ActionModel(features=spec.features * len(spec.cameras), skills=len(spec.skills), action=spec.action)
