"""The resumable training loop: killed at any instruction, it resumes to the same bits.

    <folder>/checkpoints/step-...   the full training state, every `checkpoint_every` steps
             metrics.jsonl          one row per `log_every` steps and per evaluation
             tensorboard/           the same, for TensorBoard

The loop goes through the learner's stages; a row of metrics is a mean over steps of one stage. It returns the weights
with the lowest validation loss of the last stage. The result depends on the learner, its configuration (threads
included), torch's version and the device; all are stored in each checkpoint and compared on resume. It never depends on
clocks, interruptions or logging. Tested on the CPU; on CUDA it holds as far as kernels are deterministic, which cuDNN's
LSTM does not promise.
"""

import json
import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import MISSING, asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Generic, Literal, cast

import numpy as np
import torch
from torch import Tensor

from freerein.errors import FailedPrecondition
from freerein.jobs.child import stop_on_sigterm
from freerein.jobs.event_files import EventFile
from freerein.jobs.metrics import MetricsWriter
from freerein.learning import checkpoints
from freerein.learning.checkpoints import JSON, Checkpoint
from freerein.learning.encoders import CameraEncoders
from freerein.learning.fit_config import FitConfig
from freerein.learning.learner import Learner, stage_at
from freerein.learning.train_state import (
    BatchSampler,
    BestWeights,
    FitLoopState,
    N,
    TrainState,
    from_checkpoint,
    to_checkpoint,
)


class TrainingFailed(FailedPrecondition):
    """A metric is not finite, or an image encoder is dead: more steps would not help."""


@dataclass(frozen=True)
class FitEvent:
    """An event of the training loop, for a log; `detail` is one sentence, or empty."""

    kind: Literal["resumed", "evaluated", "checkpoint_saved", "checkpoint_failed", "checkpoint_corrupt", "stopped"]
    step: int
    detail: str = ""


@dataclass(frozen=True, eq=False)
class FitResult(Generic[N]):
    """The network with the lowest validation loss, in evaluation mode.

    Attributes:
        best_step: The steps after which it was reached.
        carried: Other state of the learner at the end of the fit.
    """

    network: N
    best_step: int
    validation_loss: float
    carried: Mapping[str, Tensor] = field(default_factory=dict)

    @property
    def figures(self) -> dict[str, JSON]:
        """The figures that every model card holds."""
        return {"validation_loss": self.validation_loss, "best_step": self.best_step}


def fit_and_save(
    learner: Learner[N],
    folder: Path,
    save: Callable[[FitResult[N], Path], None],
    *,
    on_event: Callable[[FitEvent], None] = lambda _: None,
) -> bool:
    """Fits until done or SIGTERM, calibrates, then writes `folder / "model"` by `save`.

    Returns False when it was stopped before.

    Call it on the main thread. Arguments and errors are those of `fit`.
    """
    with stop_on_sigterm() as stop:
        fitted = fit(learner, folder, stop=stop, on_event=on_event)
    if fitted is None:
        return False
    learner.calibrate(fitted.network)
    save(fitted, folder / "model")
    return True


def fit(
    learner: Learner[N],
    folder: Path,
    *,
    stop: Callable[[], bool] = lambda: False,
    on_event: Callable[[FitEvent], None] = lambda _: None,
) -> FitResult[N] | None:
    """Trains, or resumes, and returns the best network; None when it was stopped before the end.

    Sets torch's number of threads, and flushing of denormal numbers, for the whole process.

    Args:
        learner: What to train.
        folder: Where checkpoints and metrics are written, and resumed from.
        stop: Polled after each step; when True, the state is saved and the loop ends.
        on_event: Called with each event, in order.

    Raises:
        FailedPrecondition: `folder` holds another fit.
        TrainingFailed: A metric is not finite, or an image encoder is dead.
        OutOfStorage: Three checkpoints in a row could not be written.
    """
    config = learner.config
    torch.set_num_threads(config.threads)
    torch.set_flush_denormal(True)
    progress = _start(learner)
    checkpointer = _Checkpointer(folder / "checkpoints", _identity(learner, progress.state), on_event)
    progress = checkpointer.resume(progress, defaults=_defaults(config))
    rows = MetricsWriter(folder / "metrics.jsonl", last_step=progress.state.step)
    events = EventFile(folder / "tensorboard", after=progress.state.step)
    while progress.state.step < config.steps and not stop():
        progress = _advance(learner, progress, rows, events, on_event)
        if progress.state.step % config.checkpoint_every == 0:
            checkpointer.save(progress, rows)
    checkpointer.save(progress, rows)
    if progress.state.step < config.steps:
        on_event(FitEvent("stopped", progress.state.step))
        return None
    network = progress.state.network.eval()  # in whichever mode the last step left it
    network.load_state_dict(progress.best.weights)
    return FitResult(network, progress.best.step, progress.best.loss, progress.state.carried)


def _start(learner: Learner[N]) -> FitLoopState[N]:
    """Weights and data order are drawn from separate generators, so that changing one does not change the other."""
    generator = torch.Generator().manual_seed(learner.config.seed)
    rng = np.random.default_rng(learner.config.seed)
    return FitLoopState(learner.init(generator), BatchSampler.start(learner.size, rng=rng))


def _identity(learner: Learner[N], state: TrainState[N]) -> dict[str, JSON]:
    """Returns the inputs on which the result depends, as a checkpoint has them."""
    config = json.loads(json.dumps(asdict(learner.config)))
    device = str(next(state.network.parameters()).device)
    return {"config": config, "data": learner.fingerprint, "torch": torch.__version__, "device": device}


def _defaults(config: FitConfig) -> dict[str, JSON]:
    """Returns the defaults of a configuration's keys: a key that is added does by default what was done before it."""
    defaults = {each.name: each.default for each in fields(config) if each.default is not MISSING}
    return cast(dict[str, JSON], json.loads(json.dumps(defaults, default=asdict)))


def _advance(
    learner: Learner[N],
    progress: FitLoopState[N],
    rows: MetricsWriter,
    events: EventFile,
    on_event: Callable[[FitEvent], None],
) -> FitLoopState[N]:
    """Makes one optimiser step; logs and evaluates when due."""
    config = learner.config
    start, stage = stage_at(learner.stages(), progress.state.step)
    stage_end = start + stage.steps
    state, metrics = learner.update(progress.state, progress.sampler.next_batch(config.batch_size))
    _check_finite(metrics, state.step)
    sums = {name: progress.metric_sums.get(name, 0.0) + value for name, value in metrics.items()}
    progress = replace(progress, state=state, metric_sums=sums, metric_count=progress.metric_count + 1)
    is_evaluated = state.step % config.evaluate_every == 0 or state.step == config.steps
    if not is_evaluated and state.step % config.log_every != 0 and state.step != stage_end:
        return progress
    row = {name: total / progress.metric_count for name, total in sums.items()}
    if is_evaluated:
        row["validation_loss"] = learner.evaluate(state)
        _check_finite(row, state.step)
        _check_encoders(state)
        if stage_end == config.steps:
            progress = replace(progress, best=_better(progress.best, state, row["validation_loss"]))
        on_event(FitEvent("evaluated", state.step, f"validation_loss {row['validation_loss']:.4f}"))
    with suppress(OSError):  # a full disk costs the row, not the fit
        rows.append(state.step, row)
    events.append(state.step, row)
    return replace(progress, metric_sums={}, metric_count=0)


def _better(best: BestWeights, state: TrainState[N], loss: float) -> BestWeights:
    if loss >= best.loss:
        return best
    return BestWeights(
        state.step, loss, {name: tensor.detach().clone() for name, tensor in state.network.state_dict().items()}
    )


def _check_finite(metrics: Mapping[str, float], step: int) -> None:
    for name, value in metrics.items():
        if not math.isfinite(value):
            raise TrainingFailed(
                f"Metrics must be finite; {name} is {value} after {step} updates.",
                hint="Lower the learning rate.",
            )


def _check_encoders(state: TrainState[N]) -> None:
    for encoders in state.network.modules():
        if isinstance(encoders, CameraEncoders) and (dead := encoders.dead_cameras()):
            raise TrainingFailed(
                f"An image encoder must tell frames apart; after {state.step} updates that of camera {dead[0]} has the "
                "same features for all training frames: it is dead.",
                hint="Lower the learning rate, `lr`, or raise `warmup_steps`.",
            )


class _Checkpointer:
    """Saves and loads the checkpoints of one fit."""

    def __init__(self, folder: Path, identity: Mapping[str, JSON], on_event: Callable[[FitEvent], None]) -> None:
        self._folder = folder
        self._identity = identity
        self._on_event = on_event
        self._saved_step = -1
        self._saver = checkpoints.Saver(folder)

    def resume(self, fresh: FitLoopState[N], *, defaults: Mapping[str, JSON]) -> FitLoopState[N]:
        """Returns the state of the newest intact checkpoint, or `fresh` without one; see `from_checkpoint`."""
        checkpoint = checkpoints.newest(
            self._folder, on_corrupt=lambda step, why: self._on_event(FitEvent("checkpoint_corrupt", step, why))
        )
        if checkpoint is None:
            return fresh
        progress = from_checkpoint(checkpoint, fresh, self._identity, defaults=defaults)
        self._saved_step = checkpoint.step
        self._on_event(FitEvent("resumed", checkpoint.step))
        return progress

    def save(self, progress: FitLoopState[N], rows: MetricsWriter) -> None:
        """Saves a checkpoint unless this step has one; ends the fit when several in a row cannot be written."""
        step = progress.state.step

        def make() -> Checkpoint:
            rows.sync()  # a power cut leaves no checkpoint without its rows, which would not be written again
            return to_checkpoint(progress, self._identity)

        def tell(why: str) -> None:
            self._on_event(FitEvent("checkpoint_failed", step, why))

        if step != self._saved_step and self._saver.save(make, tell):
            self._saved_step = step
            self._on_event(FitEvent("checkpoint_saved", step))
