"""Training of the goal-conditioned policy and its recognizer, from frames and executed actions alone."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from functools import cached_property
from typing import Literal

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freerein.errors import InvalidInput
from freerein.learning import weights
from freerein.learning.config import bounded
from freerein.learning.fit_config import FitConfig
from freerein.learning.optimiser import fit_step
from freerein.learning.train_state import TrainState
from freerein_imitation import objectives
from freerein_imitation.model import action_bins
from freerein_imitation.model.goal_conditioned import GoalConditionedNetwork, GoalConditionedSpec, proximity_logit
from freerein_imitation.model.policy import PolicyNetworkSpec
from freerein_imitation.training.goal_relabelling import (
    RecognizerBatch,
    RelabelledSlices,
    sample_recognizer_batch,
    sample_slices,
)
from freerein_imitation.training.trajectories import TrajectoryDataset, split_trajectories

State = TrainState[GoalConditionedNetwork]

_NORMALISATION_FRAMES = 2000
_EVALUATION_WINDOWS = 192
_THRESHOLD_FRAMES = 256


@dataclass(frozen=True)
class GoalConditionedConfig(FitConfig):
    """Configuration of a fit of a goal-conditioned policy.

    Attributes:
        policy: Kind of policy.
        camera: Camera whose frames to train on; may be empty where the dataset has one.
        forward_consistency_weight: lambda of eq. 3.4; 0 for no forward model.
        use_previous_action: Whether the policy takes the previous action as input, as in the dissertation.
        min_goal_steps: Fewest actions from a slice's first frame to its goal.
        max_goal_steps: Most actions from a slice's first frame to its goal.
        close_steps: Frames at most so many actions apart are positive pairs of the goal recognizer.
        far_steps: Frames of one trajectory more actions apart than that are negative pairs.
        batch_size: Windows per update; each is cut into many slices.
        features: Size of the policy's image features.
        hidden_size: Units of the LSTM.
        embedding_size: Size of the recognizer's embeddings.
        validation_fraction: Fraction of trajectories held out to choose weights and the reached threshold.

    Raises:
        InvalidInput: A minimum is above its maximum.
    """

    policy: Literal["goal_conditioned"] = "goal_conditioned"
    camera: str = ""
    forward_consistency_weight: float = bounded(0.0, least=0.0, most=100.0)
    use_previous_action: bool = True
    min_goal_steps: int = bounded(5, least=1, most=1000)
    max_goal_steps: int = bounded(15, least=1, most=1000)
    close_steps: int = bounded(2, least=1, most=1000)
    far_steps: int = bounded(15, least=1, most=10_000)
    steps: int = bounded(300, least=1, most=10_000_000)
    batch_size: int = bounded(24, least=1, most=1024)
    lr: float = bounded(6e-3, least=1e-7, most=1.0)
    features: int = bounded(128, least=8, most=1024)
    hidden_size: int = bounded(128, least=8, most=1024)
    embedding_size: int = bounded(64, least=2, most=1024)
    validation_fraction: float = bounded(0.1, least=0.01, most=0.5)
    evaluate_every: int = bounded(50, least=1, most=1_000_000)

    def __post_init__(self) -> None:
        for less, more in (("min_goal_steps", "max_goal_steps"), ("close_steps", "far_steps")):
            if getattr(self, less) > getattr(self, more):
                raise InvalidInput(
                    f"`{less}` must not be above `{more}`; got {getattr(self, less)} and {getattr(self, more)}.",
                    field=f"config.{less}",
                )

    def network_spec(self, sizes: PolicyNetworkSpec) -> GoalConditionedSpec:
        """Returns the spec of the networks for a dataset's frame and action sizes."""
        return GoalConditionedSpec(
            **asdict(sizes),
            use_previous_action=self.use_previous_action,
            forward_model=self.forward_consistency_weight > 0,
            features=self.features,
            hidden_size=self.hidden_size,
            embedding_size=self.embedding_size,
        )


@dataclass(frozen=True, eq=False)
class GoalConditionedLosses:
    """Loss terms, each float ().

    Attributes:
        action: Eq. 3.2, over all slices and timesteps.
        forward: Forward model on executed actions; 0 without one.
        consistency: Forward model on the policy's actions; 0 without one.
        recognizer: Goal recognizer.
    """

    action: Tensor
    forward: Tensor
    consistency: Tensor
    recognizer: Tensor


@dataclass(frozen=True, eq=False)
class GoalConditionedLearner:
    """Learner of a goal-conditioned policy; an item is a window of a trajectory.

    Attributes:
        config: Configuration.
        spec: Spec of the networks.
        training: Training trajectories.
        validation: Validation trajectories.
        fingerprint: Fingerprint of the dataset.
        device: Device to train on.
    """

    config: GoalConditionedConfig
    spec: GoalConditionedSpec
    training: TrajectoryDataset
    validation: TrajectoryDataset
    fingerprint: str
    device: torch.device

    @classmethod
    def prepare(
        cls,
        config: GoalConditionedConfig,
        sizes: PolicyNetworkSpec,
        trajectories: TrajectoryDataset,
        *,
        fingerprint: str,
        device: torch.device,
    ) -> "GoalConditionedLearner":
        """Returns the learner for all trajectories of a dataset, split into training and validation.

        Raises:
            InvalidInput: Fewer than 2 trajectories are long enough.
        """
        training, validation = split_trajectories(
            trajectories, fraction=config.validation_fraction, seed=config.seed, min_length=config.min_goal_steps + 1
        )
        return cls(config, config.network_spec(sizes), training, validation, fingerprint, device)

    @cached_property
    def _windows(self) -> npt.NDArray[np.int64]:
        return _windows(self.training, self.config)

    @property
    def size(self) -> int:
        """Windows in an epoch."""
        return len(self._windows)

    def init(self, generator: torch.Generator) -> State:
        """Returns the state before the first update."""
        network = GoalConditionedNetwork(self.spec)
        weights.initialise(network, generator=generator)
        network.fit_normalisation(torch.from_numpy(self.training.sample_frames(_NORMALISATION_FRAMES)))
        network = network.to(self.device)
        return TrainState(network, torch.optim.Adam(network.parameters(), self.config.lr, fused=True), generator)

    def update(self, state: State, items: npt.NDArray[np.int64]) -> tuple[State, dict[str, float]]:
        """Returns the state after one update on some windows, and its metrics."""
        config = self.config
        rng = np.random.default_rng(torch.randint(2**62, (2,), generator=state.generator).tolist())
        losses = sample_losses(state.network, self.training, self._windows[items].tolist(), rng, config=config)
        loss = (
            losses.action + losses.forward + config.forward_consistency_weight * losses.consistency + losses.recognizer
        )
        state, metrics = fit_step(state, loss, config)
        return state, metrics | {
            "action_loss": losses.action.item(),
            "recognizer_loss": losses.recognizer.item(),
        }

    def evaluate(self, state: State) -> float:
        """Returns the action loss (eq. 3.2) plus the recognizer's on validation trajectories."""
        losses = self.validation_losses(state.network)
        return (losses.action + losses.recognizer).item()

    @torch.no_grad()
    def validation_losses(self, network: GoalConditionedNetwork) -> GoalConditionedLosses:
        """Returns the mean losses on validation trajectories, on the same slices and pairs each time."""
        rng, items = np.random.default_rng(self.config.seed), _windows(self.validation, self.config)
        items = items[:: math.ceil(len(items) / _EVALUATION_WINDOWS)]
        batches = np.array_split(items, math.ceil(len(items) / self.config.batch_size))
        parts = [sample_losses(network, self.validation, batch.tolist(), rng, config=self.config) for batch in batches]
        names = [each.name for each in fields(GoalConditionedLosses)]
        return GoalConditionedLosses(*(torch.stack([getattr(part, name) for part in parts]).mean() for name in names))


def sample_losses(
    network: GoalConditionedNetwork,
    trajectories: TrajectoryDataset,
    items: Sequence[int],
    rng: np.random.Generator,
    *,
    config: GoalConditionedConfig,
) -> GoalConditionedLosses:
    """Returns the losses on slices and frames sampled from some trajectories."""
    device, steps = next(network.parameters()).device, (config.min_goal_steps, config.max_goal_steps)
    slices = sample_slices(trajectories, items, rng, steps=steps, device=device)
    frames = sample_recognizer_batch(trajectories, items, rng, close_steps=config.close_steps, device=device)
    action, forward, consistency = _policy_losses(network, slices)
    return GoalConditionedLosses(action, forward, consistency, _recognizer_loss(network, frames, config))


def _policy_losses(network: GoalConditionedNetwork, slices: RelabelledSlices) -> tuple[Tensor, Tensor, Tensor]:
    features = network.policy.encoder(slices.frames)  # (N, D)
    at, mask = slices.timesteps, slices.mask  # (S, L)
    executed = action_bins.encode(slices.actions[at], choices=network.spec.action_choices)  # (S, L, A, categories)
    logits, _ = network.policy(features[at], features[slices.goals], slices.previous[at])  # (S, L, A, categories)
    forward = consistency = features.new_zeros(())
    if (model := network.forward_model) is not None:
        fixed = features.detach()  # phi is trained by action prediction alone: else it could shrink until f is right
        now, following = fixed[at], fixed[at + 1]  # (S, L, D)
        forward = objectives.masked_mean(objectives.squared_error(model(now, executed), following), mask)
        predicted = model(now, logits.softmax(dim=-1))
        consistency = objectives.masked_mean(objectives.squared_error(predicted, following), mask)
    return objectives.masked_mean(objectives.action_cross_entropy(logits, executed), mask), forward, consistency


def _recognizer_loss(network: GoalConditionedNetwork, batch: RecognizerBatch, config: GoalConditionedConfig) -> Tensor:
    embeddings = network.recognizer(batch.frames)  # (N, embedding_size)
    logits = proximity_logit(embeddings[:, None], embeddings)  # (N, N)
    pairs = batch.pairs(close_steps=config.close_steps, far_steps=config.far_steps)
    return objectives.recognizer_loss(logits, *pairs)


@torch.no_grad()
def reached_threshold(network: GoalConditionedNetwork, trajectories: TrajectoryDataset) -> float:
    """Returns the recognizer's median probability that frames one action apart are close.

    The threshold that best separates training's pairs is far lower, and would call a goal reached too early.

    Args:
        network: Trained.
        trajectories: Validation trajectories, at least one of 2 timesteps.
    """
    device = next(network.parameters()).device
    logits = []
    for item in range(len(trajectories)):
        frames = trajectories.frames[item][:_THRESHOLD_FRAMES]
        embeddings = network.recognizer(torch.tensor(frames, device=device))  # (T, embedding_size)
        logits.append(proximity_logit(embeddings[1:], embeddings[:-1]).cpu().numpy())  # (T - 1,)
    return float(np.median(1 / (1 + np.exp(-np.concatenate(logits)))))


def _windows(trajectories: TrajectoryDataset, config: GoalConditionedConfig) -> npt.NDArray[np.int64]:
    """Returns the trajectory of each window of an epoch, int64 (n,); every timestep counts about alike."""
    counts = np.ceil(trajectories.lengths() / config.max_goal_steps).astype(np.int64)
    return np.repeat(np.arange(len(counts)), counts)
