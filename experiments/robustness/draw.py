"""The data that the benchmark draws from the worlds: demonstrations, exploration, scenes, and rollouts of policies.

    <work>/datasets/<hash>.safetensors         what a learner may see
                    <hash>.truth.safetensors   true labels and states, for evaluation

See `cache_paths` for the hash. A trajectory depends on the spec's seed and its index only, so that
those of two conditions begin alike.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Protocol

import numpy as np
import numpy.typing as npt
import safetensors.numpy
import torch

from experiments.robustness.worlds import CAMERA, DEMONSTRATED, NOMINAL, SCATTERED, open_world
from experiments.workbench.arms import world_version
from experiments.workbench.cache_paths import cache_path
from experiments.workbench.locks import locked
from freerein.atomic_files import write_atomic
from freerein.learning.actor_critic.policy_files import load_policy
from freerein.types.common import Trajectory
from freerein.types.sim import DemonstrateRequest, DemonstrateResponse
from freerein_orchestrator.rl.network_policy import NetworkPolicy
from freerein_sim.workers.demonstrations import make_demonstration
from freerein_sim.worlds.generators import generator
from freerein_sim.worlds.random_policy import SmoothRandomPolicy
from freerein_sim.worlds.tasks import tasks
from freerein_sim.worlds.world import Frame, World

Arrays = Mapping[str, npt.NDArray[Any]]

_SCENE_STEPS = 4


@dataclass(frozen=True, eq=False)
class Drawn:
    """Arrays of n trajectories, all timesteps concatenated.

    Attributes:
        seen: `lengths`, int64 (n,), with sum N; `frames`, uint8 (N, H, W, 3) of the front camera; of demonstrations
            also `actions`, float32 (N, A), and `tags`, bool (n, K).
        truth: `labels`, int64 (N,), of demonstrations; `states`, float64 (N, S), and `rewards` of the oracle, float64
            (N,), of scenes and rollouts.
    """

    seen: Arrays
    truth: Arrays

    def by_trajectory(self, name: str) -> list[npt.NDArray[Any]]:
        """Returns an array of `seen` or `truth` by trajectory."""
        both = {**self.seen, **self.truth}
        return np.split(both[name], np.cumsum(both["lengths"])[:-1])


class Spec(Protocol):
    """A draw; its fields are its identity."""

    @property
    def task(self) -> str:
        """The task."""

    def draw(self) -> Drawn:
        """Draws it."""


@dataclass(frozen=True)
class Demonstrations:
    """Trajectories of the scripted expert of `blocks`, as the sim service records them."""

    count: int
    seed: int
    least_skills: int
    most_skills: int
    condition: str = NOMINAL
    task: ClassVar[str] = DEMONSTRATED

    def draw(self) -> Drawn:
        """Draws the trajectories."""
        request = DemonstrateRequest(
            self.task, "expert", (), self.least_skills, self.most_skills, self.count, self.seed, privileged=True
        )
        replies = _demonstrate(request, self.condition)
        skills = tasks()[self.task].spec.skills
        tags = [[skill in each.trajectory.skills for skill in skills] for each in replies]
        seen = {**_stacked([each.trajectory for each in replies]), "tags": np.array(tags)}
        return Drawn(seen, {"labels": np.concatenate([each.labels for each in replies])})


@dataclass(frozen=True)
class Exploration:
    """Random actions among scattered blocks, as the sim service records them."""

    count: int
    seed: int
    task: ClassVar[str] = SCATTERED

    def draw(self) -> Drawn:
        """Draws the trajectories."""
        request = DemonstrateRequest(self.task, "random", count=self.count, seed=self.seed)
        return Drawn(_stacked([each.trajectory for each in _demonstrate(request, NOMINAL)]), {})


@dataclass(frozen=True)
class Scenes:
    """First and last frames of short random rollouts among a number of scattered blocks; a trajectory has two."""

    count: int
    seed: int
    blocks: str
    condition: str = NOMINAL
    task: ClassVar[str] = SCATTERED

    def draw(self) -> Drawn:
        """Draws the scenes."""
        episodes = []
        with closing(open_world(self.task, self.condition, self.blocks)) as world:
            for rng in _generators(self.seed, self.count):
                world.reset(rng)
                policy, first = SmoothRandomPolicy(world.spec.action, rng), _observe(world)
                for _ in range(_SCENE_STEPS):
                    world.step(policy.act().action)
                episodes.append([first, _observe(world)])
        return _joined(episodes)


@dataclass(frozen=True)
class Rollouts:
    """Episodes of a stored policy in its task, with sampled actions.

    Attributes:
        count: Number of episodes.
        seed: Seed of starts and actions.
        task: The task.
        policy: Folder of the policy.
        sha256: Hash of its weights.
        condition: Condition of the task.
    """

    count: int
    seed: int
    task: str
    policy: str
    sha256: str
    condition: str = NOMINAL

    def draw(self) -> Drawn:
        """Draws the episodes; each frame and its truth follow an action."""
        network = load_policy(Path(self.policy), device="cpu").network
        episodes = []
        with closing(open_world(self.task, self.condition)) as world:
            for index, rng in enumerate(_generators(self.seed, self.count)):
                world.reset(rng)
                policy = NetworkPolicy(network, generator=torch.Generator().manual_seed(self.seed + index))
                episodes.append(_rollout(world, policy))
        return _joined(episodes)


def open_or_draw(spec: Spec, work: Path) -> Drawn:
    """Returns what was drawn; draws it first where it was not."""
    path = dataset_path(spec, work).with_suffix(".safetensors")
    truth = path.with_suffix(".truth.safetensors")
    with locked(path.with_suffix(".lock")):
        if not path.is_file():
            drawn = spec.draw()
            write_atomic(truth, safetensors.numpy.save(dict(drawn.truth)))
            write_atomic(path, safetensors.numpy.save(dict(drawn.seen)))
    return Drawn(safetensors.numpy.load_file(path), safetensors.numpy.load_file(truth))


def dataset_path(spec: Spec, work: Path) -> Path:
    """Returns the path of what was drawn, or will be, without its suffix."""
    world = {"task": spec.task, "world_version": world_version(spec.task)}
    return cache_path(work / "datasets", {"kind": type(spec).__name__, "spec": spec, **world})


@dataclass(frozen=True, eq=False)
class _Observed:
    """A frame, uint8 (H, W, 3), and the true state, float64 (S,), and oracle reward behind it."""

    frame: Frame
    state: npt.NDArray[np.float64]
    reward: float


def _observe(world: World) -> _Observed:
    truth = world.truth()
    (camera,) = (each for each in world.spec.cameras if each.name == CAMERA)
    frame = world.render(CAMERA, height=camera.height, width=camera.width)
    return _Observed(frame.copy(), np.array(truth.state, np.float64), truth.reward)


def _rollout(world: World, policy: NetworkPolicy) -> list[_Observed]:
    observed = [_observe(world)]
    for step in range(world.spec.max_episode_steps):
        action = policy.act(observed[-1].frame[None], np.array([step == 0]))[0]
        result = world.step(action)
        observed.append(_observe(world))
        if result.terminated:
            break
    return observed[1:]


def _joined(episodes: Sequence[Sequence[_Observed]]) -> Drawn:
    steps = [step for episode in episodes for step in episode]
    seen = {"lengths": np.array([len(each) for each in episodes]), "frames": np.stack([each.frame for each in steps])}
    truth = {"states": np.stack([each.state for each in steps]), "rewards": np.array([each.reward for each in steps])}
    return Drawn(seen, truth)


def _demonstrate(request: DemonstrateRequest, condition: str) -> list[DemonstrateResponse]:
    with closing(open_world(request.task, condition)) as world:
        return [
            make_demonstration(tasks()[request.task], world, replace(request, first=index))
            for index in range(request.count)
        ]


def _stacked(trajectories: Sequence[Trajectory]) -> dict[str, npt.NDArray[Any]]:
    return {
        "lengths": np.array([len(each.actions) for each in trajectories]),
        "frames": np.concatenate([each.frames[CAMERA] for each in trajectories]),
        "actions": np.concatenate([each.actions for each in trajectories]),
    }


def _generators(seed: int, count: int) -> Iterator[np.random.Generator]:
    """Yields the generator of each trajectory; worlds save generators of this kind."""
    for index in range(count):
        yield generator(np.random.SeedSequence(seed, spawn_key=(index,)))
