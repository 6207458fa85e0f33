"""Recording policies' rollouts as a dataset, each with its policy's goal text.

Episodes are run in rounds of `num_envs`. A round depends on the seed and its position alone: an interrupted one is run
again, and those of its episodes that are on disk are skipped.

    <folder>/rollouts/                   the dataset
             checkpoints/rollouts.json   the number of episodes kept of each recorded round
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from freerein.atomic_files import write_atomic
from freerein.clients.tasks import find_task
from freerein.data import DatasetSpec, Writer, create, integer_fps, open_writer
from freerein.errors import FailedPrecondition
from freerein.types.common import ModelRef, Trajectory
from freerein.types.sim import CreateSessionRequest, Task
from freerein_orchestrator.envs.episodes import Episode, derive_seed, run_episodes
from freerein_orchestrator.envs.policies import stored_policy
from freerein_orchestrator.envs.policy_interface import PolicyInterface, common_action
from freerein_orchestrator.envs.reward_fns import LearnedReward
from freerein_orchestrator.kinds.context import RunContext
from freerein_orchestrator.rl.policy_files import StoredPolicy

ROLLOUTS = "rollouts"
Keep = Literal["all", "rewarded"]


@dataclass(frozen=True)
class RolloutPlan:
    """The episodes to run and to keep; attributes as of `DistillConfig`."""

    rollouts: int
    num_envs: int
    stochastic: bool
    seed: int
    keep: Keep

    def rounds(self, teachers: int) -> Iterator["_Round"]:
        """Yields the rounds of all teachers, in order."""
        for teacher in range(teachers):
            for first in range(0, self.rollouts, self.num_envs):
                yield _Round(teacher, first, min(self.num_envs, self.rollouts - first))


@dataclass(frozen=True)
class _Round:
    """Episodes `first` to `first + count` of a teacher."""

    teacher: int
    first: int
    count: int


def record_rollouts(context: RunContext, policies: Sequence[StoredPolicy], plan: RolloutPlan) -> None:
    """Records the rollouts that are missing, in unprivileged sessions.

    Args:
        context: The run's.
        policies: The teachers, of one spec.
        plan: What to record.

    Raises:
        Stopped: The run is to stop.
        InvalidInput: The teachers' tasks have different actions, or a reward model that is to choose what to keep does
            not know a word of its teacher's goal text.
        FailedPrecondition: No rollout of a teacher was kept.
    """
    recording = _Recording(context, policies, plan)
    if plan.keep == "rewarded":
        recording.check_goal_texts()
    with recording.open() as writer:
        for number, each in enumerate(plan.rounds(len(policies))):
            recording.record(writer, number, each)


class _Recording:
    """Runs rounds and records their episodes."""

    def __init__(self, context: RunContext, policies: Sequence[StoredPolicy], plan: RolloutPlan) -> None:
        self._root = context.folder / ROLLOUTS
        self._policies = policies
        self._plan = plan
        self._retry = context.retry()
        self._sim, self._reward = context.client("sim"), context.client("reward")
        self._tasks: list[Task] = [
            self._retry.call(partial(find_task, self._sim, str(policy.card["task"]))) for policy in policies
        ]
        (self._camera,) = PolicyInterface.of_stored(policies[0]).cameras
        self._path = context.folder / "checkpoints" / "rollouts.json"
        self._kept: list[int] = json.loads(self._path.read_bytes()) if self._path.is_file() else []
        recorded = list(plan.rounds(len(policies)))[: len(self._kept)]
        self._episodes = sum(each.count for each in recorded)
        self._metrics = context.metrics_logger(self._episodes)

    def check_goal_texts(self) -> None:
        """Raises InvalidInput where a reward model does not know a word of its teacher's goal text."""
        size = self._camera.height, self._camera.width, self._camera.channels
        for policy in self._policies:
            self._retry.call(partial(self._reward_fn(policy).resolve_model, *size))

    def open(self) -> Writer:
        action, control_dt_s = common_action(self._tasks)
        camera = self._camera
        spec = DatasetSpec(
            fps=integer_fps(control_dt_s),
            cameras={camera.name: (camera.height, camera.width, camera.channels)},
            action=action,
            robot_type=self._tasks[0].world,
            has_terminations=True,
        )
        return open_writer(self._root) if self._root.is_dir() else create(self._root, spec)

    def record(self, writer: Writer, number: int, each: _Round) -> None:
        """Runs a round and records the episodes to keep, unless that is done."""
        if number < len(self._kept):
            return
        policy = self._policies[each.teacher]
        kept = self._to_keep(policy, self._retry.call(lambda: self._run(each)))
        recorded = len(writer) - sum(self._kept)
        if recorded < 0:
            raise FailedPrecondition(
                f"The dataset must hold the {sum(self._kept)} trajectories that were recorded; it holds {len(writer)}.",
                hint="Start a new run.",
            )
        for episode in kept[recorded:]:
            writer.append(
                Trajectory(
                    frames={camera: frames[:-1] for camera, frames in episode.frames.items()},
                    actions=episode.actions,
                    goal_text=str(policy.card["goal_text"]),
                    terminated=episode.terminated,
                )
            )
        self._finish(each, kept)

    def _run(self, each: _Round) -> Sequence[Episode]:
        task = self._tasks[each.teacher]
        policy = stored_policy(self._policies[each.teacher], task, stochastic=self._plan.stochastic)
        request = CreateSessionRequest(
            task.name,
            num_envs=each.count,
            seed=derive_seed(self._plan.seed, each.teacher, each.first),
            height=policy.height,
            width=policy.width,
        )
        return run_episodes(self._sim, request, policy, self._retry.interrupt)

    def _to_keep(self, policy: StoredPolicy, episodes: Sequence[Episode]) -> Sequence[Episode]:
        if self._plan.keep == "all":
            return episodes
        reward_fn = self._reward_fn(policy)
        last = np.stack([episode.frames[self._camera.name][-2] for episode in episodes])  # of the recorded rollout
        rewards = self._retry.call(lambda: reward_fn(last, None))
        return [episode for episode, reward in zip(episodes, rewards, strict=True) if reward > 0]

    def _reward_fn(self, policy: StoredPolicy) -> LearnedReward:
        goal_text, model = str(policy.card["goal_text"]), ModelRef(**policy.card["model"])
        return LearnedReward(self._reward, goal_text, self._camera.name, model)

    def _finish(self, each: _Round, kept: Sequence[Episode]) -> None:
        self._episodes += each.count
        self._kept.append(len(kept))
        timesteps = sum(len(episode.actions) for episode in kept)
        row = {"kept": float(sum(self._kept)), "timesteps": float(timesteps)}
        self._metrics.append(self._episodes, {f"{ROLLOUTS}/{name}": value for name, value in row.items()})
        is_last = each.first + each.count == self._plan.rollouts
        rounds = -(-self._plan.rollouts // self._plan.num_envs)
        if is_last and not any(self._kept[-rounds:]):
            raise FailedPrecondition(
                f"At least one rollout of each teacher must be rewarded; none of teacher {each.teacher + 1} is.",
                field="config.keep",
                hint="Train it longer, or keep all.",
            )
        write_atomic(self._path, json.dumps(self._kept).encode())
