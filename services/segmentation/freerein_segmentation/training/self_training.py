"""Self-training inside the tag set: labels by Viterbi from a frozen copy of the network, the teacher of a round.

Labels are found when a trajectory is used: by the teacher's probabilities within the trajectory's tags, with a cost for
each switch (set-constrained Viterbi, Li and Todorovic, 2020, arXiv 2002.11925; expectation maximisation over
instances, Luo et al., 2020). With a weight for action evidence, a skill is also known by what it does (Shiarlis et
al., "TACO", 2018, arXiv 1803.01840, without its order): an action model of each skill, fitted to the teacher's labels
on the teacher's features, adds its log posterior. A teacher is plain tensors, and a part of the training state.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn

from freerein.learning import weights
from freerein_segmentation.model import Context, ModelSpec, SegmentationNetwork
from freerein_segmentation.model.action_model import ActionModel
from freerein_segmentation.training.batches import TrajectoryBatch
from freerein_segmentation.training.viterbi import viterbi

_LEAST_EVIDENCE = -5.0
"""Least log posterior of a skill given the action, in nats: one surprising action must not outweigh the network."""

_STEPS, _BATCH, _LR = 300, 256, 3e-3

_LOG_SHARE = "log_share"


@dataclass(frozen=True, eq=False)
class Teacher:
    """A frozen network that labels trajectories, with or without an action model.

    Attributes:
        network: The network.
        actions: The action model; None for a teacher that does not look at actions' evidence.
        switching_cost: Cost of each change of the skill, in nats.
        action_evidence: Weight of the action model's log posterior.
        context: Future timesteps that the network sees.
        log_share: Logarithm of each skill's share of trajectories, float (K,), which is taken off its scores, or None.
    """

    network: SegmentationNetwork
    actions: ActionModel | None
    switching_cost: float
    action_evidence: float
    context: Context
    log_share: Tensor | None

    @classmethod
    def load(
        cls,
        tensors: Mapping[str, Tensor],
        spec: ModelSpec,
        *,
        device: torch.device,
        switching_cost: float,
        action_evidence: float,
        context: Context,
    ) -> "Teacher":
        """Returns the teacher whose `tensors` are given, on a device."""
        with torch.device("meta"):  # allocates no weights
            network, actions = SegmentationNetwork(spec), _action_model(spec)
        for part, name in ((network, "network."), (actions, "actions.")):
            found = {key.removeprefix(name): tensor for key, tensor in tensors.items() if key.startswith(name)}
            if found:
                part.load_state_dict(found, assign=True)
                part.to(device)
        has_actions = any(key.startswith("actions.") for key in tensors)
        log_share = tensors[_LOG_SHARE].to(device) if _LOG_SHARE in tensors else None
        return cls(
            network.eval(), actions if has_actions else None, switching_cost, action_evidence, context, log_share
        )

    @property
    def tensors(self) -> dict[str, Tensor]:
        """All weights, by name."""
        parts: dict[str, nn.Module] = {"network": self.network}
        if self.actions is not None:
            parts["actions"] = self.actions
        tensors = {f"{part}.{name}": tensor for part in parts for name, tensor in parts[part].state_dict().items()}
        return tensors if self.log_share is None else {**tensors, _LOG_SHARE: self.log_share}

    @torch.no_grad()
    def label(self, batch: TrajectoryBatch) -> Tensor:
        """Returns labels, int64 (B, T), `NO_SKILL` in the padding."""
        features = self.network.features(batch.frames, batch.actions)  # (N, D)
        scores, mask = self.network.score_batch(features, batch.lengths, context=self.context)
        emissions = scores.log_softmax(dim=2)
        if self.log_share is not None:
            emissions = emissions - self.log_share
        if self.actions is not None:
            log_likelihood = self.actions(
                features[:, : self.network.image.size], self.network.spec.scaled(batch.actions)
            )  # (N, K)
            added = torch.zeros_like(emissions)
            added[mask] = action_posterior(log_likelihood)
            emissions = emissions + self.action_evidence * added
        return viterbi(emissions, mask, batch.tags, switching_cost=self.switching_cost)


def begin_round(
    network: SegmentationNetwork,
    batches: Iterable[TrajectoryBatch],
    *,
    switching_cost: float,
    action_evidence: float,
    context: Context,
    log_share: Tensor | None,
    generator: torch.Generator,
) -> Teacher:
    """Returns the teacher that a network becomes; an action model, where it has weight, is fitted to `batches`.

    `log_share` is for a network that sees less of the future than the one that learns its labels. By Bayes' rule,
    P(y_t | x, tags) is as P(y_t | x) P(tags | y_t, x). What the network cannot tell from x yet is as likely as it is
    among the trajectories with the skill: each has one over their number.
    """
    tensors = {f"network.{name}": tensor.detach().clone() for name, tensor in network.state_dict().items()}
    if log_share is not None:
        tensors[_LOG_SHARE] = log_share
    teacher = Teacher.load(
        tensors,
        network.spec,
        device=network.head.weight.device,
        switching_cost=switching_cost,
        action_evidence=action_evidence,
        context=context,
    )
    if not action_evidence:
        return teacher
    features, actions, labels = _labelled(teacher, batches)
    fitted = fit_action_model(features, actions, labels, spec=network.spec, generator=generator)
    return replace(teacher, actions=fitted)


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
