"""Collecting rollouts whatever happens to the services.

The rollout is the unit of recovery: when a service or a session is lost, new sessions are restored to where the
rollout started and it is collected again, to the same bits.
"""

from collections.abc import Callable, Sequence

from freerein.learning.actor_critic.networks import ActorCritic
from freerein_orchestrator.envs.retry import Retry
from freerein_orchestrator.rl.env_groups import ClosableVecEnv, EnvGroups, collect_groups
from freerein_orchestrator.rl.rollout import CollectorState, RolloutBuffer


class RecoveringCollector:
    """Collects the rollouts of one training.

    Args:
        open_envs: Returns environments restored from snapshots.
        num_steps: Timesteps per environment and rollout.
        retry: Waits for services that are unavailable.

    Attributes:
        recoveries: How often a rollout was restarted.
    """

    def __init__(
        self, open_envs: Callable[[Sequence[bytes]], EnvGroups[ClosableVecEnv]], *, num_steps: int, retry: Retry
    ) -> None:
        self.recoveries = 0
        self._open_envs = open_envs
        self._num_steps = num_steps
        self._retry = retry
        self._envs: EnvGroups[ClosableVecEnv] | None = None
        self._envs_state: CollectorState | None = None

    def collect(self, network: ActorCritic, state: CollectorState) -> tuple[RolloutBuffer, CollectorState]:
        """Returns the rollout that starts at `state`, and the state after it.

        Raises:
            IterationRejected: A service returned something malformed, or has a bug.
            Stopped: The run is to stop.
            ServiceError: A service failed permanently.
        """
        for attempt in self._retry.attempts(on_failure=self._fail):
            with attempt:
                collected = collect_groups(network, self._envs_at(state), state, num_steps=self._num_steps)
        _, self._envs_state = collected
        return collected

    def close(self) -> None:
        """Closes the sessions."""
        envs, self._envs, self._envs_state = self._envs, None, None
        if envs is not None:
            envs.close()

    def _fail(self) -> None:
        self.recoveries += 1
        self.close()

    def _envs_at(self, state: CollectorState) -> EnvGroups[ClosableVecEnv]:
        if self._envs is None or self._envs_state is not state:
            self.close()
            self._envs = self._open_envs(state.env_snapshots)
        return self._envs
