"""Short rollouts of a task, as all checks need them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from freerein.types.common import Camera
from freerein_sim.worlds.episodes import RecordedEpisode, record_episode
from freerein_sim.worlds.predicates import States
from freerein_sim.worlds.random_policy import SmoothRandomPolicy
from freerein_sim.worlds.varied_world import build
from freerein_sim.worlds.world import Action, Frame, LabelledAction, ScriptedPolicy, TaskDefinition, World, expert_of

SEED = 7
STEPS = 12


def begin(task: TaskDefinition, *, seed: int = SEED, conditions: Sequence[str] = ()) -> World:
    """Returns a world at the start of an episode."""
    world = build(task, conditions)
    world.reset(np.random.default_rng(seed))
    return world


def act_randomly(world: World, *, steps: int = STEPS) -> Iterator[Action]:
    """Steps the world with a fixed random policy; yields after each step until the episode ends."""
    policy = SmoothRandomPolicy(world.spec.action, np.random.default_rng(SEED))
    for _ in range(steps):
        action = policy.act().action
        result = world.step(action)
        yield action
        if result.terminated:
            return


def observed(world: World) -> tuple[bytes, ...]:
    """Returns true state, oracle reward and all cameras' frames as bytes."""
    views: list[Frame] = [world.render(each.name, height=each.height, width=each.width) for each in world.spec.cameras]
    truth = world.truth()
    return truth.state.tobytes(), np.float64(truth.reward).tobytes(), *(view.tobytes() for view in views)


def continued(world: World, *, steps: int = STEPS) -> list[tuple[bytes, ...]]:
    """Returns what is observed after each step of a fixed random policy."""
    return [observed(world) for _ in act_randomly(world, steps=steps)]


@dataclass(frozen=True, eq=False)
class Demonstration:
    """A demonstration of T timesteps.

    Attributes:
        episode: What was recorded.
        states: float64 (T + 1, S), the true states before each action and after the last one.
    """

    episode: RecordedEpisode
    states: npt.NDArray[np.float64]

    def attempts(self) -> Iterator[tuple[int, States]]:
        """Yields each skill in turn and the states of its segment, float64 (1, t, S), the one that ends it included."""
        labels = self.episode.labels
        begins = np.flatnonzero(np.diff(labels, prepend=labels[0] - 1))
        for first, last in zip(begins, [*begins[1:], len(labels)], strict=True):
            yield int(labels[first]), self.states[None, first : last + 1]


def demonstrate(
    world: World, recipe: Sequence[str], rng: np.random.Generator, *, cameras: Sequence[Camera] = ()
) -> Demonstration:
    """Records the expert at a recipe; frames of some cameras."""
    world.reset(rng, recipe=recipe)
    expert = _Watched(world, expert_of(world)(recipe, rng))
    episode = record_episode(world, expert, cameras=cameras, max_steps=world.spec.max_episode_steps)
    return Demonstration(episode, np.stack([*expert.states[: len(episode.actions)], world.truth().state]))


@dataclass(frozen=True, eq=False)
class _Watched:
    """A policy, and the true states in which it was asked."""

    world: World
    policy: ScriptedPolicy
    states: list[npt.NDArray[np.float64]] = field(default_factory=list)

    def act(self) -> LabelledAction | None:
        self.states.append(self.world.truth().state)
        return self.policy.act()

    def succeeded(self) -> bool:
        return self.policy.succeeded()
