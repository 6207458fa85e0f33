"""Recording a mix: stored policies and random behaviour, each in a task and under conditions of its own, in shares.

Trajectories are recorded in rounds of `num_envs`, each of one part. The part of a round is the one that lacks most
timesteps of its share of those recorded so far, so that a killed run continues as an undisturbed one.
"""

import json
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from freerein.clients import SyncClient
from freerein.clients.tasks import find_task
from freerein.data import Dataset, DatasetSpec, save_teachers
from freerein.data.dataset_recorder import dataset_spec, recording
from freerein.errors import InvalidInput, quoted
from freerein.learning.actor_critic.policy_files import StoredPolicy
from freerein.learning.checkpoints import JSON
from freerein.types.common import Trajectory
from freerein.types.sim import CreateSessionRequest, DemonstrateRequest, Task
from freerein_orchestrator.envs.episodes import derive_seed, run_episodes
from freerein_orchestrator.envs.policies import PolicyHandle, stored_policy
from freerein_orchestrator.envs.retry import Retry
from freerein_orchestrator.kinds.collect.config import PARTS_FIELD, CollectConfig, MixPart
from freerein_orchestrator.kinds.context import RunContext

Size = tuple[int, int]


def record_mix(context: RunContext, config: CollectConfig, root: Path) -> list[dict[str, Any]]:
    """Records the trajectories that are missing; returns what each part is and gave, JSON.

    Args:
        context: The run's.
        config: Its configuration.
        root: The dataset's folder.

    Raises:
        Stopped: The run is to stop.
        InvalidInput: There is no such policy, or it does not fit the task.
        ServiceError: The sim service refuses, or the dataset holds something else.
    """
    sim, retry = context.client("sim"), context.retry()
    named = [part.task or config.task for part in config.mix]
    tasks = {config.task: retry.call(partial(find_task, sim, config.task))}
    tasks |= {name: retry.call(partial(find_task, sim, name, field=PARTS_FIELD)) for name in named if name not in tasks}
    spec = _spec(tasks, config)
    policies = _load(context, config.mix)
    sources = [
        _Source(sim, retry, config, tasks[name], part, spec, _handle(policy, tasks[name], part, spec))
        for part, name, policy in zip(config.mix, named, policies, strict=True)
    ]
    cards = [_describe(each) for each in policies]
    request: dict[str, JSON] = {
        **json.loads(json.dumps(asdict(config))),
        "policies": [each["sha256"] for each in cards],
        "conditions": [*sorted(config.conditions)],
    }
    del request["count"]  # of which no trajectory depends
    acting = zip(config.mix, named, cards, strict=True)
    teachers = [{"task": name, **card} for part, name, card in acting if not part.is_random]
    with recording(root, spec, request) as writer:
        save_teachers(root, teachers)
        lengths = Dataset(root).lengths.tolist() if len(writer) else []
        metrics = context.metrics_logger(min(len(lengths), config.count - 1))
        while len(lengths) < config.count:
            number, begun = divmod(len(lengths), config.num_envs)
            source = sources[parts_of_rounds(config, lengths)[number]]
            recorded = retry.call(partial(source.round, number))
            for trajectory in recorded[begun : begun + config.count - len(lengths)]:
                writer.append(trajectory)
                lengths.append(len(trajectory.actions))
            metrics.append(len(lengths), {"timesteps": sum(lengths)})
            retry.interrupt()
    given = timesteps_of_parts(config, lengths)
    parts = zip(config.mix, cards, given, strict=True)
    return [{**asdict(part), **card, "timesteps": timesteps} for part, card, timesteps in parts]


def parts_of_rounds(config: CollectConfig, lengths: Sequence[int]) -> list[int]:
    """Returns the part of each round that was begun, and of the next, given the timesteps of trajectories so far."""
    rounds = [lengths[first : first + config.num_envs] for first in range(0, len(lengths), config.num_envs)]
    shares = [part.share / sum(each.share for each in config.mix) for part in config.mix]
    given, parts = [0] * len(shares), list[int]()
    for recorded in [*map(sum, rounds), 0]:
        lacking = [share * (sum(given) + 1) - own for share, own in zip(shares, given, strict=True)]
        parts.append(lacking.index(max(lacking)))
        given[parts[-1]] += recorded
    return parts


def timesteps_of_parts(config: CollectConfig, lengths: Sequence[int]) -> list[int]:
    """Returns the timesteps that each part gave."""
    given = [0] * len(config.mix)
    for index, part in enumerate(parts_of_rounds(config, lengths)):
        given[part] += sum(lengths[index * config.num_envs : (index + 1) * config.num_envs])
    return given


@dataclass(frozen=True, eq=False)
class _Source:
    """Where the rounds of a part come from: a policy, or without one the task's random behaviour."""

    sim: SyncClient
    retry: Retry
    config: CollectConfig
    task: Task
    part: MixPart
    spec: DatasetSpec
    handle: PolicyHandle | None

    def round(self, number: int) -> Sequence[Trajectory]:
        """Returns the trajectories of a round, `num_envs` of them: the same however often it is called."""
        config, seed, cameras = self.config, derive_seed(self.config.seed, number), tuple(self.spec.cameras)
        conditions, (height, width) = (*config.conditions, *self.part.conditions), _size(self.spec)
        if self.handle is None:
            request = DemonstrateRequest(
                self.task.name,
                "random",
                count=config.num_envs,
                seed=seed,
                cameras=cameras,
                height=height,
                width=width,
                conditions=conditions,
            )
            with closing(self.sim.demonstrate(request)) as made:
                return [each.trajectory for each in made]
        session = CreateSessionRequest(
            self.task.name, num_envs=config.num_envs, seed=seed, height=height, width=width, conditions=conditions
        )
        episodes = run_episodes(self.sim, session, self.handle, self.retry.interrupt, cameras=cameras)
        return [
            Trajectory(
                {camera: each.frames[camera][:-1] for camera in cameras}, each.actions, terminated=each.terminated
            )
            for each in episodes
        ]


def _spec(tasks: Mapping[str, Task], config: CollectConfig) -> DatasetSpec:
    """Returns the spec of the dataset.

    Raises:
        InvalidInput: The task of a part has other frames or actions, or frames differ in size between cameras.
    """
    recorded = partial(dataset_spec, cameras=config.cameras, height=config.height, width=config.width)
    specs = {name: recorded(task) for name, task in tasks.items()}
    own = specs[config.task]
    for name, each in specs.items():
        if replace(each, task=own.task, skills=own.skills, robot_type=own.robot_type) != own:
            raise InvalidInput(
                f"The tasks of a mix must have the same cameras, actions and control period; {quoted(name)} has others "
                f"than {config.task}.",
                field=PARTS_FIELD,
                hint="Record it as a dataset of its own.",
            )
    sizes = {f"{height} x {width}" for height, width, _ in own.cameras.values()}
    if len(sizes) > 1:
        raise InvalidInput(
            f"The cameras of a mix must have frames of one size; got {' and '.join(sorted(sizes))}.",
            field="config.height",
            hint="Set `height` and `width`.",
        )
    return own


def _size(spec: DatasetSpec) -> Size:
    """Returns height and width of the frames of all cameras."""
    ((height, width),) = {size[:2] for size in spec.cameras.values()}
    return height, width


def _handle(policy: StoredPolicy | None, task: Task, part: MixPart, spec: DatasetSpec) -> PolicyHandle | None:
    """Returns a policy as it acts. Raises InvalidInput where it does not act on the frames that are recorded."""
    if policy is None:
        return None
    handle, (height, width) = stored_policy(policy, task, stochastic=part.stochastic), _size(spec)
    if (handle.height, handle.width) != (height, width):
        raise InvalidInput(
            f"A policy acts on the frames that are recorded; it sees {handle.height} x {handle.width}, and those are "
            f"{height} x {width}.",
            field="config.height",
            hint="Leave `height` and `width` out, or record with a policy of that size.",
        )
    return handle


def _load(context: RunContext, parts: Sequence[MixPart]) -> list[StoredPolicy | None]:
    """Returns the policy of each part; the same versions as in earlier attempts."""
    store = context.policies
    store.pin(part.policy for part in parts if not part.is_random)
    return [
        None if part.is_random else store.load(part.policy, field=PARTS_FIELD, device=context.device) for part in parts
    ]


def _describe(policy: StoredPolicy | None) -> dict[str, Any]:
    """Returns a policy's description and supervision, JSON; `learned_timesteps` are not among those recorded."""
    if policy is None:
        return {"sha256": "", "reward": "", "supervision": "none", "privileged": False, "learned_timesteps": 0}
    card = policy.card
    return {
        "sha256": card["sha256"],
        "reward": card.get("reward", ""),
        "supervision": card.get("supervision", ""),
        "privileged": card.get("privileged") is True,
        "learned_timesteps": card.get("figures", {}).get("timesteps", 0),
    }
