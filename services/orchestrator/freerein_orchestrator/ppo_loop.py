"""The iterations of a training by PPO: experience is collected on one thread while another learns from the last.

    learner   theta 0 ── learns from rollout 0 ──> theta 1 ── learns from rollout 1 ──> theta 2 ...
    actor     rollout 0 by theta 0 | rollout 1 by theta 0  |  rollout 2 by theta 1      |  ...

The actor is one iteration behind, which the weights of timesteps account for: what the policy that learning begins with
would rather not have done counts less. The ratios of PPO are to that policy, and every value is its critic's. Which
bits come of it depends on the order of the work, never on which thread is faster.
"""

from collections.abc import Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from functools import partial
from types import TracebackType
from typing import Self, TypeAlias

import torch

from freerein_orchestrator.networks import ActorCritic
from freerein_orchestrator.patience import Stopped
from freerein_orchestrator.ppo import learn
from freerein_orchestrator.ppo_training import Outset, PPOTraining, frozen
from freerein_orchestrator.rollout import Rollout

Gather: TypeAlias = Callable[[ActorCritic, Outset], tuple[Rollout, Outset]]
"""Returns the rollout of an actor from an outset on, and the outset of the next one; called on another thread."""

_LOOK_S = 0.1
_END_S = 0.6


def iterations(
    training: PPOTraining, gather: Gather, *, interrupt: Callable[[], None] = lambda: None
) -> Generator[PPOTraining]:
    """Yields the training after each iteration that it has still to make; networks are changed in place.

    What is yielded is saved before the next one is asked for. After an error, go on from what was saved. Sets torch's
    number of threads, and flushing of denormal numbers, for the whole process.

    Args:
        training: Before the first of them.
        gather: Collects experience.
        interrupt: Called all the time; raises `Stopped` once the training is to stop.

    Raises:
        Stopped: It was told to.
        Rejected: The iteration is worthless.
        ServiceError: What `gather` raises.
    """
    config = training.config
    if training.iteration >= config.iterations:
        return
    _prepare_thread(config.threads)
    with _Acting(gather, threads=config.threads, interrupt=interrupt) as acting:
        acting.begin(training.actor, training.outset)
        while training.iteration < config.iterations:
            rollout, outset = acting.finish()
            goes_on = training.iteration + 1 < config.iterations
            act = partial(acting.begin, outset=outset) if goes_on else frozen
            ahead = act(training.network) if config.overlap else None
            progress, metrics = learn(training.progress, rollout, config, interrupt=interrupt)
            actor = ahead or act(progress.state.network)
            training = PPOTraining(config, progress, actor, outset, training.terms, metrics | _earned(rollout))
            yield training


class _Acting:
    """The thread that collects, one rollout at a time."""

    def __init__(self, gather: Gather, *, threads: int, interrupt: Callable[[], None]) -> None:
        self._gather = gather
        self._interrupt = interrupt
        self._thread = ThreadPoolExecutor(1, "actor", _prepare_thread, (threads,))
        self._ahead: list[Future[tuple[Rollout, Outset]]] = []

    def begin(self, network: ActorCritic, outset: Outset) -> ActorCritic:
        """Begins to collect by a copy of a network, which is returned."""
        actor = frozen(network)
        self._ahead = [self._thread.submit(self._gather, actor, outset)]
        return actor

    def finish(self) -> tuple[Rollout, Outset]:
        """Returns what was collected when it is there."""
        (rollout,) = self._ahead
        while not rollout.done():
            self._interrupt()
            wait(self._ahead, _LOOK_S)
        return rollout.result()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Waits for the thread; when told to stop, for a moment: what it hangs on is closed by whoever made it."""
        if kind is not None:
            wait(self._ahead, _END_S if issubclass(kind, Stopped) else None)
        self._thread.shutdown(wait=False)


def _prepare_thread(threads: int) -> None:
    """Makes this thread compute as every other one of the training does: flushing is a thread's own setting."""
    torch.set_num_threads(threads)
    torch.set_flush_denormal(True)


def _earned(rollout: Rollout) -> dict[str, float]:
    """Returns what the episodes that ended came to, on average; nothing where none did."""
    if not len(rollout.returns):
        return {}
    return {
        "episode_return": rollout.returns.mean().item(),
        "episode_length": rollout.lengths.double().mean().item(),
    }
