"""Rollouts of policies as a dataset that a student learns from, each with the goal text of its policy.

They are played in rounds, of as many episodes as environments step together. A round follows from the seed and its
place alone: one whose recording was interrupted is played again, and what is recorded of it already is passed over.

    <folder>/rollouts/                   the dataset
             checkpoints/rollouts.json   how many episodes were kept of each round that is recorded
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from freerein.atomic_files import write_atomic
from freerein.data import DatasetSpec, Writer, create, integer_fps, open_writer
from freerein.errors import FailedPrecondition
from freerein.types.common import ModelRef, Trajectory
from freerein.types.sim import CreateSessionRequest, Task
from freerein_orchestrator.actors import of_policy
from freerein_orchestrator.bearings import Bearing, agreed_action
from freerein_orchestrator.drive import Episode, find_task, play, seed_of
from freerein_orchestrator.judges import LearnedReward
from freerein_orchestrator.patience import Patience
from freerein_orchestrator.policy_artifact import Policy
from freerein_orchestrator.served_rollouts import persist
from freerein_orchestrator.work import Work

ROLLOUTS = "rollouts"
Keep = Literal["all", "rewarded"]


@dataclass(frozen=True)
class Schedule:
    """How much of each teacher is played.

    Attributes:
        rollouts: Episodes of each teacher.
        num_envs: Environments that step together.
        is_stochastic: Whether actions are drawn; else the likeliest is taken.
        seed: Of every episode.
        keep: Which episodes are recorded: `all`, or those in whose last frame the model that rewarded the teacher sees
            the goal.
    """

    rollouts: int
    num_envs: int
    is_stochastic: bool
    seed: int
    keep: Keep


@dataclass(frozen=True)
class _Round:
    """Episodes `begun` to `begun + count` of the teacher of a number."""

    teacher: int
    begun: int
    count: int


def record(work: Work, policies: Sequence[Policy], schedule: Schedule, patience: Patience) -> None:
    """Records the rollouts that are missing, in sessions without privileges.

    Args:
        work: Where the dataset is recorded, and the curve.
        policies: The teachers, which see and do the same.
        schedule: How much.
        patience: Waits for services that are away.

    Raises:
        InvalidInput: Actions mean something else in the task of one teacher.
        FailedPrecondition: Nothing was kept of a teacher.
        Stopped: The work is to stop.
    """
    recording = _Recording(work, policies, schedule, patience)
    with recording.open() as writer:
        for number, each in enumerate(_rounds(schedule, len(policies))):
            recording.record(writer, number, each)


def _rounds(schedule: Schedule, teachers: int) -> Iterator[_Round]:
    for teacher in range(teachers):
        for begun in range(0, schedule.rollouts, schedule.num_envs):
            yield _Round(teacher, begun, min(schedule.num_envs, schedule.rollouts - begun))


class _Recording:
    """Rollouts that are played and recorded."""

    def __init__(self, work: Work, policies: Sequence[Policy], schedule: Schedule, patience: Patience) -> None:
        self._root = work.folder / ROLLOUTS
        self._policies = policies
        self._schedule = schedule
        self._patience = patience
        self._sim, self._reward = work.client("sim"), work.client("reward")
        self._tasks: list[Task] = [
            patience.ask(partial(find_task, self._sim, str(policy.card["task"]))) for policy in policies
        ]
        self._bearing = Bearing.of(policies[0])
        self._path = work.folder / "checkpoints" / "rollouts.json"
        self._kept: list[int] = json.loads(self._path.read_bytes()) if self._path.is_file() else []
        recorded = list(_rounds(schedule, len(policies)))[: len(self._kept)]
        self._played = sum(each.count for each in recorded)
        self._curve = work.curve(last_step=self._played)

    def open(self) -> Writer:
        action, control_dt_s = agreed_action(self._tasks)
        size = (self._bearing.height, self._bearing.width, self._bearing.channels)
        spec = DatasetSpec(integer_fps(control_dt_s), {self._bearing.camera: size}, action, self._tasks[0].world)
        return open_writer(self._root) if self._root.is_dir() else create(self._root, spec)

    def record(self, writer: Writer, number: int, each: _Round) -> None:
        """Plays a round and records what is to be kept of it, unless that is done."""
        if number < len(self._kept):
            return
        policy = self._policies[each.teacher]
        kept = self._chosen(policy, persist(lambda: self._play(each), self._patience))
        for episode in kept[len(writer) - sum(self._kept) :]:
            frames = {self._bearing.camera: episode.frames}
            writer.append(Trajectory(frames, episode.actions, goal_text=str(policy.card["goal_text"])))
        self._finish(each, kept)

    def _play(self, each: _Round) -> Sequence[Episode]:
        task, policy = self._tasks[each.teacher], self._policies[each.teacher]
        pilot = of_policy(policy, task, is_stochastic=self._schedule.is_stochastic)
        request = CreateSessionRequest(
            task.name,
            num_envs=each.count,
            seed=seed_of(self._schedule.seed, each.teacher, each.begun),
            height=pilot.height,
            width=pilot.width,
        )
        return play(self._sim, request, pilot, self._patience.interrupt)

    def _chosen(self, policy: Policy, episodes: Sequence[Episode]) -> Sequence[Episode]:
        if self._schedule.keep == "all":
            return episodes
        goal_text, model = str(policy.card["goal_text"]), ModelRef(**policy.card["model"])
        judge = LearnedReward(self._reward, goal_text, self._bearing.camera, model)
        last = np.stack([episode.frames[-1] for episode in episodes])
        rewards = persist(lambda: judge(last, None), self._patience)
        return [episode for episode, reward in zip(episodes, rewards, strict=True) if reward > 0]

    def _finish(self, each: _Round, kept: Sequence[Episode]) -> None:
        self._played += each.count
        self._kept.append(len(kept))
        lengths = [len(episode.actions) for episode in kept]
        row = {"kept": float(sum(self._kept)), "timesteps": float(sum(lengths))}
        self._curve.append(self._played, {f"{ROLLOUTS}/{name}": value for name, value in row.items()})
        is_last = each.begun + each.count == self._schedule.rollouts
        rounds = -(-self._schedule.rollouts // self._schedule.num_envs)
        if is_last and not any(self._kept[-rounds:]):
            raise FailedPrecondition(
                f"Something of each teacher must be rewarded; nothing of teacher {each.teacher + 1} is.",
                field="config.keep",
                hint="Train it longer, or keep all.",
            )
        write_atomic(self._path, json.dumps(self._kept).encode())
