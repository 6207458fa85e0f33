"""Training state, and its exact conversion to a checkpoint and back."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Generic, TypeVar, cast

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from freerein.errors import FailedPrecondition
from freerein.learning.checkpoints import JSON, Checkpoint

N = TypeVar("N", bound=nn.Module)


@dataclass(frozen=True, eq=False)
class TrainState(Generic[N]):
    """The state that an optimiser step changes; network and optimiser are updated in place.

    Attributes:
        generator: Source of all randomness of an optimiser step, on the CPU.
        step: Optimiser steps done.
        carried: Other state of a learner, by name; it is saved with the rest.
    """

    network: N
    optimiser: torch.optim.Optimizer
    generator: torch.Generator
    step: int = 0
    carried: Mapping[str, Tensor] = field(default_factory=dict)

    @classmethod
    def with_adam(cls, network: N, lr: float, *, generator: torch.Generator, amsgrad: bool = False) -> "TrainState[N]":
        """Returns the initial state of a network that Adam trains; frozen parameters stay as they are.

        `amsgrad` chooses the variant of Reddi et al. (2018), whose second moments never fall.
        """
        trainable = [parameter for parameter in network.parameters() if parameter.requires_grad]
        return cls(network, torch.optim.Adam(trainable, lr, fused=True, amsgrad=amsgrad), generator)

    def rng(self) -> np.random.Generator:
        """Returns numpy's generator for one step, seeded by the next draw of `generator`."""
        return np.random.default_rng(torch.randint(2**62, (2,), generator=self.generator).tolist())


@dataclass(eq=False)
class BatchSampler:
    """Draws minibatches without replacement, epoch after epoch; the last, incomplete batch of an epoch is dropped.

    Attributes:
        rng: Generator of each epoch's permutation.
        order: int64 (n,), the permutation of the current epoch.
        position: Number of items of `order` already drawn.
    """

    rng: np.random.Generator
    order: npt.NDArray[np.int64]
    position: int

    @classmethod
    def start(cls, count: int, *, rng: np.random.Generator) -> "BatchSampler":
        """Returns the sampler of `count` items before its first batch."""
        return cls(rng, rng.permutation(count), 0)

    def next_batch(self, batch_size: int) -> npt.NDArray[np.int64]:
        """Returns the indices of the next batch, int64 (min(batch_size, n),)."""
        size = min(batch_size, len(self.order))
        if self.position + size > len(self.order):
            self.order, self.position = self.rng.permutation(len(self.order)), 0
        self.position += size
        return self.order[self.position - size : self.position]


@dataclass(frozen=True, eq=False)
class BestWeights:
    """A copy of the weights with the lowest validation loss so far, which is infinite before the first evaluation."""

    step: int = 0
    loss: float = float("inf")
    weights: Mapping[str, Tensor] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class FitLoopState(Generic[N]):
    """The full state of a fit between two optimiser steps.

    Attributes:
        sampler: Sampler of the training items.
        metric_sums: Sum of each metric since the last row of metrics.
        metric_count: Number of optimiser steps in `metric_sums`.
    """

    state: TrainState[N]
    sampler: BatchSampler
    best: BestWeights = BestWeights()
    metric_sums: Mapping[str, float] = field(default_factory=dict)
    metric_count: int = 0


def to_checkpoint(progress: FitLoopState[N], identity: Mapping[str, JSON]) -> Checkpoint:
    """Returns the checkpoint of a state; `identity` is what the result depends on, compared on resume."""
    state, best = progress.state, progress.best
    tensors = {
        **{f"network/{name}": tensor for name, tensor in state.network.state_dict().items()},
        **{f"best/{name}": tensor for name, tensor in best.weights.items()},
        **_moments(state.optimiser),
        **{f"carried/{name}": tensor for name, tensor in state.carried.items()},
        "generator": state.generator.get_state(),
        "order": torch.from_numpy(progress.sampler.order),
    }
    document: dict[str, JSON] = {
        "identity": dict(identity),
        "rng": cast(JSON, progress.sampler.rng.bit_generator.state),
        "position": progress.sampler.position,
        "best": {"step": best.step, "loss": best.loss} if best.weights else None,
        "metric_sums": dict(progress.metric_sums),
        "metric_count": progress.metric_count,
    }
    return Checkpoint(state.step, tensors, document)


def from_checkpoint(
    checkpoint: Checkpoint,
    fresh: FitLoopState[N],
    identity: Mapping[str, JSON],
    *,
    defaults: Mapping[str, JSON] | None = None,
) -> FitLoopState[N]:
    """Returns the state of a checkpoint, loaded into the objects of a fresh state.

    Args:
        checkpoint: The checkpoint.
        fresh: State before the first step.
        identity: Present inputs of the fit, on which its result depends.
        defaults: Keys of its `config` that a checkpoint of an earlier version may lack, with the values that it had.

    Raises:
        FailedPrecondition: The checkpoint has another identity.
    """
    document = checkpoint.document
    then = cast(Mapping[str, JSON], document["identity"])
    config = cast(Mapping[str, JSON], then.get("config", {}))
    _check_identity({**then, "config": {**(defaults or {}), **config}}, identity)
    state, rng = fresh.state, fresh.sampler.rng
    state.network.load_state_dict(tensors_under("network/", checkpoint.tensors))
    _load_moments(state.optimiser, checkpoint.tensors)
    state.generator.set_state(checkpoint.tensors["generator"])
    rng.bit_generator.state = cast(Mapping[str, object], document["rng"])
    best = cast(Mapping[str, float] | None, document["best"])
    return FitLoopState(
        replace(state, step=checkpoint.step, carried=tensors_under("carried/", checkpoint.tensors)),
        BatchSampler(rng, checkpoint.tensors["order"].numpy(), cast(int, document["position"])),
        BestWeights(int(best["step"]), best["loss"], tensors_under("best/", checkpoint.tensors))
        if best
        else BestWeights(),
        cast(Mapping[str, float], document["metric_sums"]),
        cast(int, document["metric_count"]),
    )


def tensors_under(prefix: str, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Returns the tensors whose names begin with a prefix, by the rest of their names."""
    return {name.removeprefix(prefix): tensor for name, tensor in tensors.items() if name.startswith(prefix)}


def _moments(optimiser: torch.optim.Optimizer) -> dict[str, Tensor]:
    by_parameter: Mapping[int, Mapping[str, Tensor]] = optimiser.state_dict()["state"]
    return {
        f"optimiser/{index}/{name}": tensor
        for index, moments in by_parameter.items()
        for name, tensor in moments.items()
    }


def _load_moments(optimiser: torch.optim.Optimizer, tensors: Mapping[str, Tensor]) -> None:
    """Gives each moment its parameter's memory layout: another layout may round differently."""
    parameters = [parameter for group in optimiser.param_groups for parameter in group["params"]]
    state: dict[int, dict[str, Tensor]] = {}
    for path, tensor in tensors_under("optimiser/", tensors).items():
        index, _, name = path.partition("/")
        parameter = parameters[int(index)]
        moment = torch.empty_like(parameter).copy_(tensor) if tensor.shape == parameter.shape else tensor
        state.setdefault(int(index), {})[name] = moment
    optimiser.load_state_dict({"state": state, "param_groups": optimiser.state_dict()["param_groups"]})


def _check_identity(then: Mapping[str, JSON], now: Mapping[str, JSON]) -> None:
    before, after = dict(_leaves(then)), dict(_leaves(now))
    changed = sorted(name for name in before.keys() | after.keys() if before.get(name) != after.get(name))
    if changed:
        changes = ", ".join(f"{name} was {before.get(name)} and is {after.get(name)}" for name in changed)
        raise FailedPrecondition(
            f"A fit must be resumed with the settings that it was started with; {changes}.",
            field=changed[0],
            hint="Restore these settings, or start a new fit.",
        )


def _leaves(tree: Mapping[str, JSON], prefix: str = "") -> list[tuple[str, JSON]]:
    found: list[tuple[str, JSON]] = []
    for name, value in tree.items():
        found += _leaves(value, f"{prefix}{name}.") if isinstance(value, dict) else [(prefix + name, value)]
    return found
