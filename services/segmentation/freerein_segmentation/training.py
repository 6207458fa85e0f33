"""How the segmentation network learns: from images, executed actions, and the set of skills of each trajectory."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Protocol, TypeVar

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from freerein.errors import InvalidInput
from freerein.learning import weights
from freerein.learning.checkpoints import JSON
from freerein.learning.config import bounded, parse
from freerein.learning.fit import Plan
from freerein.learning.progress import TrainingState
from freerein_segmentation.model import Context, ModelSpec, SegmentationNetwork
from freerein_segmentation.objectives import OBJECTIVES, ObjectiveName

D_co = TypeVar("D_co", bound=np.generic, covariant=True)
State = TrainingState[SegmentationNetwork]

_CALIBRATION_FRAMES = 2000
_GRADIENT_NORM = 1.0


@dataclass(frozen=True)
class SegmentationConfig:
    """Everything that a fit may choose; the rest is the network of section 2.3.

    Attributes:
        camera: Whose frames to learn from; empty where the dataset has one camera.
        stride: Timesteps from one that the network sees to the next: 1 where skills may last a few timesteps only, more
            where they are long and frames alike, to see more trajectories in the same time.
        objective: `lse`, the dissertation's, or `lse_per_timestep`, ours.
        context: `causal`, the dissertation's, or `bidirectional`: labelling is done after the fact.
        use_actions: Whether the network sees the executed actions.
        steps: Updates.
        batch_size: Trajectories per update.
        learning_rate: Of Adam, at its highest: it rises over `warmup_steps` and falls to zero as a cosine.
        warmup_steps: Updates.
        features: Image features.
        hidden: Units of the LSTM, in each direction.
        validation_share: The share of trajectories held out to choose the best weights, by their tags alone.
        evaluate_every: Updates between looks at the held-out trajectories.
        checkpoint_every: Updates between checkpoints.
        log_every: Updates between rows of metrics.
        seed: Of every random draw.
        threads: Of torch on the CPU; one is usually as fast as two, the network being small.
    """

    camera: str = ""
    objective: ObjectiveName = "lse_per_timestep"
    context: Context = "bidirectional"
    use_actions: bool = True
    stride: int = bounded(1, least=1, most=100)
    steps: int = bounded(300, least=1, most=10_000_000)
    batch_size: int = bounded(16, least=1, most=1024)
    learning_rate: float = bounded(2e-3, least=1e-7, most=1.0)
    warmup_steps: int = bounded(30, least=1, most=1_000_000)
    features: int = bounded(64, least=8, most=1024)
    hidden: int = bounded(100, least=8, most=1024)
    validation_share: float = bounded(0.1, least=0.01, most=0.5)
    evaluate_every: int = bounded(25, least=1, most=1_000_000)
    checkpoint_every: int = bounded(50, least=1, most=1_000_000)
    log_every: int = bounded(5, least=1, most=1_000_000)
    seed: int = bounded(0, least=0, most=2**31 - 1)
    threads: int = bounded(1, least=1, most=256)

    @classmethod
    def from_mapping(cls, values: Mapping[str, object]) -> "SegmentationConfig":
        """Returns the configuration that `values` describe; what is left out has its default.

        Raises:
            InvalidInput: A key is unknown, or a value has the wrong type or is out of bounds.
        """
        return parse(cls, values)

    @property
    def plan(self) -> Plan:
        """How long to train, and how often to look."""
        return Plan(
            steps=self.steps,
            batch_size=self.batch_size,
            evaluate_every=self.evaluate_every,
            checkpoint_every=self.checkpoint_every,
            log_every=self.log_every,
            seed=self.seed,
            threads=self.threads,
        )


class Trajectories(Protocol[D_co]):
    """One array (T, ...) per trajectory: a list of arrays, or `freerein.data.cache.StepCache`."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int, /) -> npt.NDArray[D_co]: ...


@dataclass(frozen=True, eq=False)
class Demonstrations:
    """All that the learner sees of demonstrations; labels of timesteps have no way in.

    Attributes:
        frames: By trajectory, uint8 (T, H, W, C).
        actions: By trajectory, float32 (T, A) in [-1, 1] or int64 (T, 1).
        skills: By trajectory, the set of skills that occur, at least one.

    Raises:
        InvalidInput: The three do not belong together, or a trajectory has no tags.
    """

    frames: Trajectories[np.uint8]
    actions: Trajectories[np.float32] | Trajectories[np.int64]
    skills: Sequence[tuple[str, ...]]

    def __post_init__(self) -> None:
        counts = len(self.frames), len(self.actions), len(self.skills)
        if len(set(counts)) > 1 or counts[0] == 0:
            raise InvalidInput(f"Frames, actions and skills must be of as many trajectories, at least 1; got {counts}.")
        for index in range(counts[0]):
            timesteps = len(self.frames[index]), len(self.actions[index])
            if timesteps[0] != timesteps[1] or timesteps[0] == 0 or not self.skills[index]:
                raise InvalidInput(
                    f"Trajectory {index} must have as many frames as actions, at least 1, and a skill; "
                    f"got {timesteps[0]}, {timesteps[1]} and {len(self.skills[index])} skills.",
                    hint="Leave it out of the dataset, or tag it with the skills that occur in it.",
                )

    def __len__(self) -> int:
        return len(self.frames)

    def subset(self, items: Sequence[int]) -> "Demonstrations":
        """Returns some of the trajectories, without copying a frame."""
        actions: Any = [self.actions[item] for item in items]
        return Demonstrations([self.frames[item] for item in items], actions, [self.skills[item] for item in items])


def hold_out(demonstrations: Demonstrations, *, share: float, seed: int) -> tuple[Demonstrations, Demonstrations]:
    """Returns the trajectories to learn from and those held out, a random `share`, at least one of each.

    Raises:
        InvalidInput: There is only one.
    """
    if len(demonstrations) < 2:
        raise InvalidInput("A fit needs at least 2 trajectories, one of them to hold out; got 1.")
    order = np.random.default_rng(seed).permutation(len(demonstrations)).tolist()
    count = min(max(1, round(share * len(order))), len(order) - 1)
    return demonstrations.subset(sorted(order[count:])), demonstrations.subset(sorted(order[:count]))


def design(
    config: SegmentationConfig, demonstrations: Demonstrations, *, skills: tuple[str, ...], action_choices: int
) -> ModelSpec:
    """Returns the network that fits the demonstrations.

    Args:
        config: What was chosen.
        demonstrations: Whose first trajectory shows the sizes.
        skills: All skills, in the order of their labels.
        action_choices: How many different actions there are when they are discrete, else 0.

    Raises:
        InvalidInput: A trajectory is tagged with a skill that is not in `skills`.
    """
    unknown = {skill for tags in demonstrations.skills for skill in tags} - set(skills)
    if unknown:
        raise InvalidInput(
            f"Trajectories must be tagged with the {len(skills)} skills of the dataset; {len(unknown)} tags are others."
        )
    height, width, channels = demonstrations.frames[0].shape[1:]
    action_size = demonstrations.actions[0].shape[1] if config.use_actions else 0
    return ModelSpec(
        skills=skills,
        camera=config.camera,
        height=height,
        width=width,
        channels=channels,
        action_size=action_size,
        action_choices=action_choices if action_size else 0,
        stride=config.stride,
        context=config.context,
        features=config.features,
        hidden=config.hidden,
    )


@dataclass(frozen=True, eq=False)
class Batch:
    """Some trajectories, one after the other.

    Attributes:
        frames: uint8 (N, H, W, C).
        actions: float32 (N, A) or int64 (N, 1).
        lengths: int64 (B,), the timesteps of each trajectory, N together.
        tags: bool (B, K), the skills of each trajectory.
    """

    frames: Tensor
    actions: Tensor
    lengths: Tensor
    tags: Tensor


def gather(
    demonstrations: Demonstrations,
    items: Sequence[int],
    phases: Sequence[int],
    *,
    spec: ModelSpec,
    device: torch.device,
) -> Batch:
    """Returns some trajectories, every `spec.stride`-th timestep of each, as tensors on a device.

    Args:
        demonstrations: Where they are.
        items: Which.
        phases: The first timestep of each; taken modulo its length where it is shorter than the stride.
        spec: The network that they are for.
        device: Where it is.
    """
    frames, actions = [], []
    for item, phase in zip(items, phases, strict=True):
        seen, done = demonstrations.frames[item], demonstrations.actions[item]
        frames.append(seen[phase % len(seen) :: spec.stride])
        actions.append(done[phase % len(seen) :: spec.stride])
    tags = [[skill in demonstrations.skills[item] for skill in spec.skills] for item in items]
    return Batch(
        torch.from_numpy(np.concatenate(frames)).to(device),
        torch.from_numpy(np.concatenate(actions)).to(device),
        torch.tensor([len(each) for each in frames], device=device),
        torch.tensor(tags, device=device),
    )


def init(
    config: SegmentationConfig,
    spec: ModelSpec,
    demonstrations: Demonstrations,
    *,
    generator: torch.Generator,
    device: torch.device,
) -> State:
    """Returns the state before the first update; the encoder's background is that of the demonstrations."""
    network = SegmentationNetwork(spec)
    weights.draw(network, generator=generator)
    network.image.calibrate(torch.from_numpy(_spread(demonstrations, _CALIBRATION_FRAMES)))
    network = network.to(device)
    return TrainingState(network, torch.optim.Adam(network.parameters(), config.learning_rate, fused=True), generator)


def update(state: State, batch: Batch, *, config: SegmentationConfig) -> tuple[State, dict[str, float]]:
    """Returns the state after one update, and its `train_loss`."""
    for group in state.optimiser.param_groups:
        group["lr"] = learning_rate(config, state.step)
    loss = _losses(state.network, batch, config.objective).mean()
    state.optimiser.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]  # torch does not annotate it
    nn.utils.clip_grad_norm_(state.network.parameters(), _GRADIENT_NORM)
    state.optimiser.step()
    return replace(state, step=state.step + 1), {"train_loss": loss.item()}


@torch.no_grad()
def evaluate(state: State, demonstrations: Demonstrations, *, config: SegmentationConfig) -> float:
    """Returns the mean loss on held-out trajectories: how well their tags are told, the only truth that may choose."""
    spec, device = state.network.spec, state.network.head.weight.device
    batches = [
        range(start, min(start + config.batch_size, len(demonstrations)))
        for start in range(0, len(demonstrations), config.batch_size)
    ]
    losses = [
        _losses(
            state.network, gather(demonstrations, batch, [0] * len(batch), spec=spec, device=device), config.objective
        )
        for batch in batches
    ]
    return torch.cat(losses).mean().item()


def learning_rate(config: SegmentationConfig, step: int) -> float:
    """Returns the learning rate of the update after `step` others: a linear rise, then half a cosine down to zero."""
    rise = min(1.0, (step + 1) / config.warmup_steps)
    return config.learning_rate * rise * 0.5 * (1.0 + math.cos(math.pi * step / config.steps))


@dataclass(frozen=True, eq=False)
class SegmentationProblem:
    """Segmentation as `freerein.learning.fit` learns it.

    Attributes:
        config: What was chosen.
        spec: The network.
        training: To learn from.
        validation: Held out.
        fingerprint: Of the dataset.
        device: Where to compute.
    """

    config: SegmentationConfig
    spec: ModelSpec
    training: Demonstrations
    validation: Demonstrations
    fingerprint: str
    device: torch.device

    @property
    def size(self) -> int:
        """Trajectories to learn from."""
        return len(self.training)

    @property
    def identity(self) -> dict[str, JSON]:
        """What the result depends on."""
        return {"config": asdict(self.config), "data": self.fingerprint}

    def init(self, generator: torch.Generator) -> State:
        """Returns the state before the first update."""
        return init(self.config, self.spec, self.training, generator=generator, device=self.device)

    def update(self, state: State, items: npt.NDArray[np.int64]) -> tuple[State, dict[str, float]]:
        """Returns the state after one update on some trajectories, and its metrics."""
        phases = torch.randint(self.spec.stride, (len(items),), generator=state.generator).tolist()
        batch = gather(self.training, items.tolist(), phases, spec=self.spec, device=self.device)
        return update(state, batch, config=self.config)

    def evaluate(self, state: State) -> float:
        """Returns the loss on the held-out trajectories."""
        return evaluate(state, self.validation, config=self.config)


def _losses(network: SegmentationNetwork, batch: Batch, objective: ObjectiveName) -> Tensor:
    scores, mask = network(batch.frames, batch.actions, batch.lengths)
    return OBJECTIVES[objective](scores, mask, batch.tags)


def _spread(demonstrations: Demonstrations, count: int) -> npt.NDArray[np.uint8]:
    """Returns about `count` frames, spread evenly over trajectories and time."""
    total = sum(len(demonstrations.frames[item]) for item in range(len(demonstrations)))
    every = max(1, total // count)
    return np.concatenate([demonstrations.frames[item][item % every :: every] for item in range(len(demonstrations))])
