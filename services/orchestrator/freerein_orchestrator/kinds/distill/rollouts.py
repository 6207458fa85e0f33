"""Recording rollouts as a dataset, each with the goal text of one teacher.

In the first iteration the teachers act. In later ones a student acts, conditioned on the goal text, and the recorded
actions are the teacher's (DAgger, Ross et al. 2011): the student learns to return from where its own errors lead.

Where all teachers learned from a learned reward, its model judges which frames show the goal: the student learns to say
so.

Episodes are run in rounds of `num_envs`. A round depends on the seed, its position and the student alone: an
interrupted one is run again, and those of its episodes that are on disk are skipped.

    <folder>/rollouts/                   the dataset
             checkpoints/rollouts.json   the number of episodes kept of each recorded round
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np
import numpy.typing as npt

from freerein.atomic_files import write_atomic
from freerein.clients.tasks import find_task
from freerein.data import DatasetSpec, Writer, create, integer_fps, open_writer, reached
from freerein.errors import FailedPrecondition
from freerein.learning.actor_critic.policy_files import StoredPolicy
from freerein.types.common import Camera, Goal, ModelRef, Trajectory
from freerein.types.sim import CreateSessionRequest, Task
from freerein_orchestrator.envs.episodes import Episode, derive_seed, run_episodes
from freerein_orchestrator.envs.policies import PolicyHandle, served_policy, stored_policy
from freerein_orchestrator.envs.policy_interface import PolicyInterface, common_action
from freerein_orchestrator.kinds.context import RunContext
from freerein_orchestrator.kinds.observed_cameras import ObservedCameras
from freerein_orchestrator.rewards.learned import LearnedReward
from freerein_orchestrator.rl.network_policy import NetworkPolicy
from freerein_orchestrator.rl.vec_env import join_cameras

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


def record_rollouts(
    context: RunContext, policies: Sequence[StoredPolicy], plan: RolloutPlan, *, students: Sequence[ModelRef] = ()
) -> None:
    """Records the rollouts of an iteration that are missing, in unprivileged sessions.

    Args:
        context: The run's.
        policies: The teachers, of one spec.
        plan: What to record.
        students: The student of each earlier iteration, of which the last acts; empty in the first iteration.

    Raises:
        Stopped: The run is to stop.
        InvalidInput: The teachers' tasks have different actions, or a reward model that is to judge frames does not
            know a word of its teacher's goal text.
        FailedPrecondition: No rollout of a teacher was kept.
    """
    recording = _Recording(context, policies, plan, students)
    if not students:
        recording.check_goal_texts()
    with recording.open() as writer:
        for number, each in enumerate(plan.rounds(len(policies))):
            recording.record(writer, number, each)


class _Recording:
    """Runs rounds and records their episodes."""

    def __init__(
        self,
        context: RunContext,
        policies: Sequence[StoredPolicy],
        plan: RolloutPlan,
        students: Sequence[ModelRef],
    ) -> None:
        self._root = context.folder / ROLLOUTS
        self._policies = policies
        self._plan = plan
        self._students = students
        self._retry = context.retry()
        self._sim, self._reward, self._imitation = (context.client(each) for each in ("sim", "reward", "imitation"))
        self._tasks: list[Task] = [
            self._retry.call(partial(find_task, self._sim, str(policy.card["task"]))) for policy in policies
        ]
        self._is_judged = all(policy.card.get("reward") == "learned" for policy in policies)
        self._cameras = PolicyInterface.of_stored(policies[0]).cameras
        seen = [*self._cameras, *(camera for policy in policies if self._is_judged for camera in _rewarded(policy))]
        self._recorded = tuple(dict.fromkeys(camera.name for camera in seen))
        self._path = context.folder / "checkpoints" / "rollouts.json"
        self._kept: list[int] = json.loads(self._path.read_bytes()) if self._path.is_file() else []
        rounds = list(plan.rounds(len(policies)))
        self._earlier = len(students) * len(rounds)  # rounds of earlier iterations
        recorded = rounds[: len(self._kept) - self._earlier]
        self._episodes = len(students) * len(policies) * plan.rollouts + sum(each.count for each in recorded)
        self._metrics = context.metrics_logger(self._episodes)

    def check_goal_texts(self) -> None:
        """Raises InvalidInput where a reward model that judges frames does not know a word of its goal text."""
        for policy in self._policies if self._is_judged else ():
            self._retry.call(partial(self._reward_of(policy).resolve, _rewarded(policy)))

    def open(self) -> Writer:
        action, control_dt_s = common_action(self._tasks)
        spec = DatasetSpec(
            fps=integer_fps(control_dt_s),
            cameras={each.name: (each.height, each.width, each.channels) for each in self._cameras},
            action=action,
            robot_type=self._tasks[0].world,
            has_terminations=True,
            control_dt_s=control_dt_s,
        )
        return open_writer(self._root) if self._root.is_dir() else create(self._root, spec)

    def record(self, writer: Writer, number: int, each: _Round) -> None:
        """Runs a round of this iteration and records the episodes to keep, unless that is done."""
        if self._earlier + number < len(self._kept):
            return
        policy = self._policies[each.teacher]
        kept = self._retry.call(lambda: self._run_student(each) if self._students else self._run_teacher(each))
        recorded = len(writer) - sum(self._kept)
        if recorded < 0:
            raise FailedPrecondition(
                f"The dataset must hold the {sum(self._kept)} trajectories that were recorded; it holds {len(writer)}.",
                hint="Start a new run.",
            )
        for episode in kept[recorded:]:
            if self._is_judged:
                reached.save(self._root, len(writer), self._reached(policy, episode))
            writer.append(
                Trajectory(
                    frames={camera.name: episode.frames[camera.name][:-1] for camera in self._cameras},
                    actions=episode.actions,
                    goal_text=str(policy.card["goal_text"]),
                    terminated=episode.terminated,
                )
            )
        self._finish(each, kept)

    def _run_teacher(self, each: _Round) -> Sequence[Episode]:
        """Returns the episodes to keep of a teacher."""
        policy, handle = self._policies[each.teacher], self._teacher(each, stochastic=self._plan.stochastic)
        request = self._session(each, handle)
        return self._to_keep(policy, self._run(request, handle))

    def _run_student(self, each: _Round) -> Sequence[Episode]:
        """Returns episodes of the student with the most likely actions of the teacher."""
        teacher, goal = (
            self._teacher(each, stochastic=False),
            Goal(text=str(self._policies[each.teacher].card["goal_text"])),
        )
        request = self._session(each, teacher)
        student = served_policy(self._imitation, self._students[-1], self._tasks[each.teacher])
        episodes = self._run(request, student, goals=[goal] * each.count)
        return relabelled(episodes, self._policies[each.teacher])

    def _run(
        self, request: CreateSessionRequest, policy: PolicyHandle, *, goals: Sequence[Goal] = ()
    ) -> Sequence[Episode]:
        return run_episodes(self._sim, request, policy, self._retry.interrupt, goals=goals, cameras=self._recorded)

    def _teacher(self, each: _Round, *, stochastic: bool) -> PolicyHandle:
        return stored_policy(self._policies[each.teacher], self._tasks[each.teacher], stochastic=stochastic)

    def _session(self, each: _Round, policy: PolicyHandle) -> CreateSessionRequest:
        iteration = (len(self._students),) if self._students else ()
        return CreateSessionRequest(
            self._tasks[each.teacher].name,
            num_envs=each.count,
            seed=derive_seed(self._plan.seed, each.teacher, each.first, *iteration),
            height=policy.height,
            width=policy.width,
        )

    def _to_keep(self, policy: StoredPolicy, episodes: Sequence[Episode]) -> Sequence[Episode]:
        if self._plan.keep == "all":
            return episodes
        reward = self._reward_of(policy)
        names = [camera.name for camera in _rewarded(policy)]
        last = {name: np.stack([each.frames[name][-2] for each in episodes]) for name in names}  # of recorded rollouts
        rewards = self._retry.call(lambda: reward.of_frames(last))
        return [episode for episode, each in zip(episodes, rewards, strict=True) if each > 0]

    def _reached(self, policy: StoredPolicy, episode: Episode) -> npt.NDArray[np.bool_]:
        """Returns which recorded frames show the goal, bool (T,), by the reward model that the teacher learned from."""
        reward = self._reward_of(policy)
        frames = {camera.name: episode.frames[camera.name][:-1] for camera in _rewarded(policy)}
        return self._retry.call(lambda: reward.of_frames(frames)) > 0

    def _reward_of(self, policy: StoredPolicy) -> LearnedReward:
        goal_text, model = str(policy.card["goal_text"]), ModelRef(**policy.card["model"])
        return LearnedReward(self._reward, goal_text, model)

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


def _rewarded(policy: StoredPolicy) -> tuple[Camera, ...]:
    """Returns the cameras that a teacher's reward sees."""
    return ObservedCameras.of_inputs(policy.card, policy.network.spec).reward


def relabelled(episodes: Sequence[Episode], teacher: StoredPolicy) -> Sequence[Episode]:
    """Returns episodes with the actions that a teacher would have taken at their frames, instead of the executed ones.

    Args:
        episodes: Of one task; their frames are what the teacher sees, from the first on, and what was executed before a
            frame is its last action.
        teacher: Takes the most likely actions.
    """
    acting, count = NetworkPolicy(teacher.network), len(episodes)
    lengths = [len(each.actions) for each in episodes]
    steps = []
    for t in range(max(lengths)):
        seen = [(each, min(t, length - 1)) for each, length in zip(episodes, lengths, strict=True)]
        frames = {camera: np.stack([each.frames[camera][at] for each, at in seen]) for camera in teacher.cameras}
        executed = np.stack([each.actions[at - 1] for each, at in seen])
        starts = np.full(count, t == 0)
        steps.append(acting.act(join_cameras(frames, teacher.cameras), starts, executed=executed))
    return [
        replace(each, actions=np.stack([step[env] for step in steps[:length]]))
        for env, (each, length) in enumerate(zip(episodes, lengths, strict=True))
    ]
