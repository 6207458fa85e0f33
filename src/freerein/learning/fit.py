"""The training loop: it may be killed at any instruction and goes on to the same bits.

    <folder>/checkpoints/step-...   the whole state, every `checkpoint_every` updates
             metrics.jsonl          a row per `log_every` updates and per evaluation

What is to be learnt comes as a `Learner`. The loop keeps the weights that did best on held-out data, by the training's
own signal, and returns them. Bits depend on the learner, the plan (threads among it), torch's version and the device,
which are written into each checkpoint and compared on resume; never on clocks, interruptions or logging. That much is
tested on the CPU; on CUDA it holds as far as the kernels are deterministic, which cuDNN's LSTM does not promise.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Generic, Literal, Protocol

import numpy as np
import numpy.typing as npt
import torch

from freerein.errors import FailedPrecondition
from freerein.jobs.metrics import MetricsWriter
from freerein.learning import checkpoints
from freerein.learning.checkpoints import JSON
from freerein.learning.shuffle import Shuffle
from freerein.learning.train_state import Best, FitLoopState, N, TrainState, from_checkpoint, to_checkpoint

_SAVE_FAILURES = 3


@dataclass(frozen=True)
class Plan:
    """How long to train, and how often to look.

    Attributes:
        steps: Updates.
        batch_size: Items per update.
        evaluate_every: Updates between evaluations on held-out data; the last update is always followed by one.
        checkpoint_every: Updates between checkpoints.
        log_every: Updates between rows of metrics.
        seed: Of every random draw.
        threads: Of torch on the CPU.
    """

    steps: int
    batch_size: int
    evaluate_every: int
    checkpoint_every: int
    log_every: int
    seed: int
    threads: int


class Learner(Protocol[N]):
    """Something to be learnt, as the loop knows it."""

    @property
    def size(self) -> int:
        """Items to learn from."""

    @property
    def identity(self) -> Mapping[str, JSON]:
        """What, besides the plan, the result depends on: the configuration, the fingerprint of the data."""

    def init(self, generator: torch.Generator) -> TrainState[N]:
        """Returns the state before the first update."""

    def update(self, state: TrainState[N], items: npt.NDArray[np.int64]) -> tuple[TrainState[N], Mapping[str, float]]:
        """Returns the state after one update on some items, and its metrics, by the same names each time."""

    def evaluate(self, state: TrainState[N]) -> float:
        """Returns the loss on held-out data, by the training's own signal: never by labels of timesteps."""


@dataclass(frozen=True)
class FitEvent:
    """Something worth a line in a log.

    Attributes:
        kind: What happened.
        step: The update that it concerns.
        detail: A sentence, or empty.
    """

    kind: Literal["resumed", "evaluated", "checkpoint_saved", "checkpoint_failed", "checkpoint_corrupt", "stopped"]
    step: int
    detail: str = ""


@dataclass(frozen=True, eq=False)
class FitResult(Generic[N]):
    """What a training came to.

    Attributes:
        network: With the weights that did best on held-out data, in evaluation mode.
        best_step: After how many updates they did.
        validation_loss: Their loss there.
    """

    network: N
    best_step: int
    validation_loss: float


def fit(
    learner: Learner[N],
    plan: Plan,
    folder: Path,
    *,
    stop: Callable[[], bool] = lambda: False,
    on_event: Callable[[FitEvent], None] = lambda _: None,
) -> FitResult[N] | None:
    """Trains, or goes on training, and returns the best weights; None when it was stopped before the end.

    Sets torch's number of threads, and flushing of denormal numbers, for the whole process.

    Args:
        learner: What to learn.
        plan: How long.
        folder: Checkpoints and metrics; what is there already is gone on with.
        stop: Asked after each update; once it says True the state is saved and the loop ends.
        on_event: Told what happens, in order.

    Raises:
        FailedPrecondition: `folder` holds another training, the loss is not finite, or checkpoints cannot be written.
    """
    torch.set_num_threads(plan.threads)
    torch.set_flush_denormal(True)
    progress = _begin(learner, plan)
    identity = _identity(learner, plan, progress.state)
    saver = _Saver(folder / "checkpoints", identity, on_event)
    progress = saver.resume(progress)
    rows = MetricsWriter(folder / "metrics.jsonl", last_step=progress.state.step)
    while progress.state.step < plan.steps and not stop():
        progress = _advance(learner, plan, progress, rows, on_event)
        if progress.state.step % plan.checkpoint_every == 0:
            saver.save(progress)
    saver.save(progress)
    if progress.state.step < plan.steps:
        on_event(FitEvent("stopped", progress.state.step))
        return None
    network = progress.state.network.eval()  # however the last update, here or before a restart, left it
    network.load_state_dict(progress.best.weights)
    return FitResult(network, progress.best.step, progress.best.loss)


def _begin(learner: Learner[N], plan: Plan) -> FitLoopState[N]:
    """Weights and the order of the data come from streams of their own: changing one does not move the other."""
    generator = torch.Generator().manual_seed(plan.seed)
    return FitLoopState(learner.init(generator), Shuffle.begin(learner.size, rng=np.random.default_rng(plan.seed)))


def _identity(learner: Learner[N], plan: Plan, state: TrainState[N]) -> dict[str, JSON]:
    device = next(state.network.parameters()).device
    return {**learner.identity, "plan": asdict(plan), "torch": torch.__version__, "device": str(device)}


def _advance(
    learner: Learner[N],
    plan: Plan,
    progress: FitLoopState[N],
    rows: MetricsWriter,
    on_event: Callable[[FitEvent], None],
) -> FitLoopState[N]:
    """Makes one update, and writes and evaluates when it is time to."""
    state, metrics = learner.update(progress.state, progress.shuffle.draw(plan.batch_size))
    _check_finite(metrics, state.step)
    sums = {name: progress.sums.get(name, 0.0) + value for name, value in metrics.items()}
    progress = replace(progress, state=state, sums=sums, summed=progress.summed + 1)
    is_evaluated = state.step % plan.evaluate_every == 0 or state.step == plan.steps
    if not is_evaluated and state.step % plan.log_every != 0:
        return progress
    row = {name: total / progress.summed for name, total in sums.items()}
    if is_evaluated:
        row["validation_loss"] = learner.evaluate(state)
        _check_finite(row, state.step)
        progress = replace(progress, best=_better(progress.best, state, row["validation_loss"]))
        on_event(FitEvent("evaluated", state.step, f"validation_loss {row['validation_loss']:.4f}"))
    rows.append(state.step, row)
    return replace(progress, sums={}, summed=0)


def _better(best: Best, state: TrainState[N], loss: float) -> Best:
    if loss >= best.loss:
        return best
    return Best(
        state.step, loss, {name: tensor.detach().clone() for name, tensor in state.network.state_dict().items()}
    )


def _check_finite(metrics: Mapping[str, float], step: int) -> None:
    for name, value in metrics.items():
        if not math.isfinite(value):
            raise FailedPrecondition(
                f"A training's metrics must stay finite; {name} is {value} after {step} updates.",
                hint="Lower the learning rate; the last checkpoint is from before.",
            )


class _Saver:
    """Writes and reads the checkpoints of one training."""

    def __init__(self, folder: Path, identity: Mapping[str, JSON], on_event: Callable[[FitEvent], None]) -> None:
        self._folder = folder
        self._identity = identity
        self._on_event = on_event
        self._saved_step = -1
        self._failures = 0

    def resume(self, fresh: FitLoopState[N]) -> FitLoopState[N]:
        """Returns the progress of the newest whole checkpoint, `fresh` when there is none."""
        checkpoint = checkpoints.newest(
            self._folder, on_corrupt=lambda step, why: self._on_event(FitEvent("checkpoint_corrupt", step, why))
        )
        if checkpoint is None:
            return fresh
        progress = from_checkpoint(checkpoint, fresh, self._identity)
        self._saved_step = checkpoint.step
        self._on_event(FitEvent("resumed", checkpoint.step))
        return progress

    def save(self, progress: FitLoopState[N]) -> None:
        """Writes a checkpoint unless this step has one. A full disk does not end the training until it stays full."""
        step = progress.state.step
        if step == self._saved_step:
            return
        try:
            checkpoints.save(self._folder, to_checkpoint(progress, self._identity))
        except OSError as error:
            self._failures += 1
            self._on_event(FitEvent("checkpoint_failed", step, error.strerror or "The disk failed."))
            if self._failures >= _SAVE_FAILURES:
                raise FailedPrecondition(
                    f"Checkpoints must be writable; {_SAVE_FAILURES} in a row could not be written.",
                    hint="Free some space; the fit goes on from its last checkpoint.",
                ) from error
            return
        self._saved_step, self._failures = step, 0
        self._on_event(FitEvent("checkpoint_saved", step))
