"""A training from its beginning, or from where it was killed, to its end: saved after each iteration, and rolled back.

<folder>/checkpoints/step-...   the whole state, after each iteration
"""

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Protocol

from freerein.errors import FailedPrecondition
from freerein.learning import checkpoints
from freerein.learning.checkpoints import Checkpoint
from freerein_orchestrator.curve import Curve
from freerein_orchestrator.networks import ActorCritic
from freerein_orchestrator.ppo_loop import iterations
from freerein_orchestrator.ppo_training import Outset, PPOTraining, snapshot
from freerein_orchestrator.rejection import Rejected
from freerein_orchestrator.rollout import Rollout

_IN_A_ROW = 3


class Rollouts(Protocol):
    """Where experience comes from."""

    @property
    def recoveries(self) -> int:
        """How often a rollout has been begun again."""

    def gather(self, actor: ActorCritic, outset: Outset) -> tuple[Rollout, Outset]:
        """Returns the rollout of an actor from an outset on, and the outset of the next one."""

    def close(self) -> None:
        """Frees what is held."""


class Course:
    """Takes one training to its end.

    Args:
        folder: Of the run.
        begin: Returns the training before its first iteration.
        resume: Returns the training that a checkpoint is of.
        rollouts: Returns where a training's experience comes from.
        curve: Returns what metrics are written to, given the last step that is saved.
        interrupt: Raises `Stopped` once the training is to stop.
        say: Writes a line to the log.
    """

    def __init__(
        self,
        folder: Path,
        *,
        begin: Callable[[], PPOTraining],
        resume: Callable[[Checkpoint], PPOTraining],
        rollouts: Callable[[PPOTraining], Rollouts],
        curve: Callable[[int], Curve],
        interrupt: Callable[[], None],
        say: Callable[[str], None],
    ) -> None:
        self._folder = folder / "checkpoints"
        self._begin = begin
        self._resume = resume
        self._rollouts = rollouts
        self._curve = curve
        self._interrupt = interrupt
        self._say = say
        self._rejected = 0
        self._unsaved = 0

    def finish(self) -> PPOTraining:
        """Returns the training at its end, gone on with from the last checkpoint as often as an iteration is worthless.

        Raises:
            Stopped: It was told to.
            FailedPrecondition: Three iterations in a row were worthless, or could not be saved.
            ServiceError: What else beginning it, resuming it or collecting raises.
        """
        while True:
            try:
                return self._go_on()
            except Rejected as error:
                self._rejected += 1
                self._say(f"Rolled back, {self._rejected} in a row: {error.detail}")
                if self._rejected == _IN_A_ROW:
                    raise _diagnosis(error, self._saved_iteration()) from error

    def _go_on(self) -> PPOTraining:
        training = self._saved()
        if training is None:
            training = self._begin()
            self._save(training)
        with ExitStack() as ending:
            rollouts = self._rollouts(training)
            ending.callback(rollouts.close)
            curve = ending.enter_context(closing(self._curve(training.iteration)))
            made = ending.enter_context(closing(iterations(training, rollouts.gather, interrupt=self._interrupt)))
            for training in self._timed(made, rollouts, curve):
                self._save(training)
        return training

    def _timed(self, made: Iterator[PPOTraining], rollouts: Rollouts, curve: Curve) -> Iterator[PPOTraining]:
        """Yields iterations whose metrics are written. A row that a crash leaves without a checkpoint is made again."""
        begun_s, recoveries = time.monotonic(), 0
        for training in made:
            config, ended_s, recovered = training.config, time.monotonic(), rollouts.recoveries
            steps = config.num_envs * config.steps
            row = {
                **training.metrics,
                "timesteps": float(training.iteration * steps),
                "steps_per_s": steps / (ended_s - begun_s),
                "recoveries": float(recovered - recoveries),
                "rejected": float(self._rejected),
                "privileged": float(training.terms.get("privileged") is True),
            }
            curve.append(training.iteration, row)
            yield training
            begun_s, recoveries, self._rejected = ended_s, recovered, 0

    def _save(self, training: PPOTraining) -> None:
        try:
            checkpoints.save(self._folder, snapshot(training))
            self._unsaved = 0
        except OSError as error:
            self._unsaved += 1
            self._say(f"Iteration {training.iteration} could not be saved: {error.strerror}")
            if self._unsaved == _IN_A_ROW:
                raise FailedPrecondition(
                    f"Checkpoints must be saved; {_IN_A_ROW} in a row could not be.", hint="Is the disk full?"
                ) from error

    def _saved(self) -> PPOTraining | None:
        found = checkpoints.newest(
            self._folder, on_corrupt=lambda step, detail: self._say(f"Checkpoint {step} is passed over: {detail}")
        )
        return None if found is None else self._resume(found)

    def _saved_iteration(self) -> int:
        training = self._saved()
        return 0 if training is None else training.iteration


def _diagnosis(error: Rejected, saved: int) -> FailedPrecondition:
    return FailedPrecondition(
        f"Iteration {saved + 1} was worthless {_IN_A_ROW} times in a row; the last time: {error.detail}",
        hint=error.hint,
    )
