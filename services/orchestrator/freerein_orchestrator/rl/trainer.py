"""The training loop: collect, reward, update, save; a killed training resumes to the same bits.

<folder>/checkpoints/step-...   the complete state, after each iteration
"""

import time
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Protocol

import torch

from freerein.errors import FailedPrecondition
from freerein.learning import checkpoints
from freerein.learning.checkpoints import Checkpoint
from freerein_orchestrator.rl import ppo
from freerein_orchestrator.rl.errors import IterationRejected
from freerein_orchestrator.rl.rollout import Collector, RolloutBuffer
from freerein_orchestrator.rl.state import PPOState, to_checkpoint

_MAX_FAILURES = 3


class MetricsLog(Protocol):
    """Where metrics are written, a row per iteration."""

    def append(self, step: int, metrics: Mapping[str, float]) -> None:
        """Writes a row."""


class Recorder(Protocol):
    """Keeps rollouts as trajectories; the training ends once there are enough."""

    @property
    def target(self) -> int:
        """Trajectories wanted."""

    def count(self, rollout: RolloutBuffer) -> int:
        """Returns the number of trajectories in a rollout."""

    def record(self, rollout: RolloutBuffer, first: int) -> None:
        """Records the trajectories of a rollout that are not yet on disk; `first` is the number of the first one."""


@dataclass(frozen=True)
class Trainer:
    """Trains a policy to the end, from its last checkpoint where there is one.

    Attributes:
        folder: The run's folder.
        init: Returns the state before the first iteration.
        load: Returns the state of a checkpoint.
        collector: Returns what collects the rollouts of a state.
        metrics_log: Returns the log, given the last step that is saved.
        interrupt: Called often; raises `Stopped` to stop.
        log_line: Writes a line to the log.
        recorder: Keeps the rollouts; None to discard them.
        threads: Torch threads on the CPU.
    """

    folder: Path
    init: Callable[[], PPOState]
    load: Callable[[Checkpoint], PPOState]
    collector: Callable[[PPOState], Collector]
    metrics_log: Callable[[int], MetricsLog]
    interrupt: Callable[[], None] = lambda: None
    log_line: Callable[[str], None] = lambda _: None
    recorder: Recorder | None = None
    threads: int = 1

    def train(self) -> PPOState:
        """Returns the state after the last iteration. A rejected iteration is repeated from the last checkpoint.

        Sets torch's number of threads, and flushing of denormal numbers, for the whole process.

        Raises:
            Stopped: `interrupt` raised it.
            FailedPrecondition: An iteration was rejected three times in a row.
            OutOfStorage: Three checkpoints in a row could not be saved.
            ServiceError: What else `init`, `load` or collecting raises.
        """
        torch.set_num_threads(self.threads)
        torch.set_flush_denormal(True)
        rejected = 0
        while True:
            state = self._saved_state()
            started = -1 if state is None else state.iteration
            try:
                return self._run(state or self.init(), rejected)
            except IterationRejected as error:
                saved = self._saved_state()
                iteration = 0 if saved is None else saved.iteration
                rejected = rejected + 1 if iteration == max(started, 0) else 1
                self.log_line(f"Rolled back, {rejected} in a row: {error.detail}")
                if rejected == _MAX_FAILURES:
                    raise FailedPrecondition(
                        f"Iteration {iteration + 1} was rejected {_MAX_FAILURES} times in a row: {error.detail}",
                        hint=error.hint,
                    ) from error

    def _run(self, state: PPOState, rejected: int) -> PPOState:
        saver = checkpoints.Saver(self.folder / "checkpoints")
        if state.iteration == 0:
            saver.save(partial(to_checkpoint, state), partial(self._tell_unsaved, state.iteration))
        log = self.metrics_log(self._step(state))
        with closing(self.collector(state)) as collector:
            while not self._is_done(state):
                began_s, before, recoveries = time.monotonic(), state.timesteps, collector.recoveries
                state, rollout = self._iterate(state, collector)
                row = {
                    **state.metrics,
                    "timesteps": float(state.timesteps),
                    "lr": state.schedule.lr(state.config, state.learner.state.step),
                    "steps_per_s": (state.timesteps - before) / (time.monotonic() - began_s),
                    "recoveries": float(collector.recoveries - recoveries),
                    "rejected": float(rejected),
                    "privileged": float(state.inputs.get("privileged") is True),
                }
                log.append(self._step(state), row)  # before the trajectories: a recorded one has its row
                if self.recorder is not None:
                    self.recorder.record(rollout, state.recorded - self.recorder.count(rollout))
                saver.save(partial(to_checkpoint, state), partial(self._tell_unsaved, state.iteration))
                rejected = 0
        return state

    def _tell_unsaved(self, iteration: int, why: str) -> None:
        self.log_line(f"Iteration {iteration} could not be saved: {why}")

    def _iterate(self, state: PPOState, collector: Collector) -> tuple[PPOState, RolloutBuffer]:
        """One iteration of PPO: collect, reward, update the policy, update what rewards it."""
        self.interrupt()
        if state.config.final_log_std is not None:
            state.network.set_log_std(state.schedule.log_std(state.config, state.iteration))
        rollout, after = collector.collect(state.network, state.collector)
        first, *added = [reward.rewards(rollout) for reward in state.rewards]
        episodes, ended = state.episodes.update(first, rollout.dones, rollout.given_up)
        rewards, normaliser = sum(added, start=first), state.normaliser
        if normaliser is not None:
            rewards, normaliser = normaliser.normalise(rewards, rollout.dones, gamma=state.config.gamma)
        learner, metrics = ppo.update(
            state.learner, rollout, rewards, state.config, schedule=state.schedule, interrupt=self.interrupt
        )
        for reward in state.rewards:
            metrics |= reward.update(rollout)
        metrics |= ended.metrics(action_repeat=state.network.spec.action_repeat)
        recorded = state.recorded + (0 if self.recorder is None else self.recorder.count(rollout))
        state = replace(
            state,
            learner=learner,
            collector=after,
            episodes=episodes,
            normaliser=normaliser,
            recorded=recorded,
            metrics=metrics,
        )
        return state, rollout

    def _step(self, state: PPOState) -> int:
        """Returns the step that metrics are logged under: iterations, or recorded trajectories."""
        return state.iteration if self.recorder is None else min(state.recorded, self.recorder.target)

    def _is_done(self, state: PPOState) -> bool:
        if self.recorder is not None:
            return state.recorded >= self.recorder.target
        return state.iteration >= state.config.iterations

    def _saved_state(self) -> PPOState | None:
        found = checkpoints.newest(
            self.folder / "checkpoints",
            on_corrupt=lambda step, detail: self.log_line(f"Checkpoint {step} is skipped: {detail}"),
        )
        return None if found is None else self.load(found)
