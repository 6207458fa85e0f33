"""Each world behaves as is recorded of its version: starts, first frames, demonstrations and random rollouts.

`python tests/sim/test_worlds_golden.py` records what has no record of the world's version. What MuJoCo and OpenGL
compute differs a little between machines (decision 40): numbers have tolerances, frames are means of coarse blocks, and
where contacts amplify last bits, a minority of the episodes may differ.
"""

import base64
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from freerein.types.common import Camera
from freerein_sim.worlds.episodes import record_episode
from freerein_sim.worlds.random_policy import SmoothRandomPolicy
from freerein_sim.worlds.tasks import tasks
from freerein_sim.worlds.varied_world import build
from freerein_sim.worlds.world import Frame, TaskDefinition, World, expert_of

COMMAND = "python tests/sim/test_worlds_golden.py"
FOLDER = Path(__file__).parents[1] / "golden" / "worlds"
GOALS = ("blocks.yellow-left-of-green", "blocks.yellow-right-of-green", "blocks.yellow-on-top-of-green", "push")
"""Of the goals of blocks those that policies ship for; the others differ in their colours alone."""

RECORDED = [task for task in tasks().values() if not task.goal_text or task.name in GOALS]
WORLDS = {each.world: [task.name for task in RECORDED if task.world == each.world] for each in RECORDED}
"""Recorded tasks of each world."""

UNDER_CONDITIONS = ("blocks", "blocks.scatter", GOALS[0])
"""Tasks that are recorded under the conditions of their world, too."""

TOLERANCES = {"start": 5e-4, "frames": 3, "length": 3, "action": 1e-3, "rollout": 1e-2}
"""Largest differences: in units of the true state, grey levels, timesteps, and units of actions; 0 for all else."""

CHAOTIC = {"skills", "ends", "success", "action", "rollout"}
"""What a minority of the episodes may differ in."""

EPISODES, MOST_SKILLS, ROLLOUT_STEPS, BLOCKS, DECIMALS = 5, 2, 10, 8, 4
FEWER_EPISODES = {"bins.uneven": 3, "doom.v1": 2, "doom.v2": 2, "office.2": 3, "office.3": 3}
"""Episodes of tasks whose demonstrations take long to simulate, or that differ little from others."""

Episode = Mapping[str, Any]
Cases = Mapping[str, Sequence[Episode]]
"""Episodes by task, and by task and condition."""


@pytest.mark.parametrize("world", WORLDS)
def test_a_world_behaves_as_is_recorded_of_its_version(world: str, keep_open: Callable[..., None]) -> None:
    for name in WORLDS[world]:
        keep_open(tasks()[name])
    recorded = read(world)
    assert recorded["version"] == version_of(world), f"its version has no record: run {COMMAND}"

    differences = list(compare(recorded["cases"], record(world)))

    assert not differences, (
        f"The behaviour of the world {world} changed: {'; '.join(differences)}. Undo the change, or raise the world's "
        f"version, which voids its results, and run {COMMAND}"
    )


def test_a_larger_change_than_between_machines_is_found() -> None:
    then: Episode = {"recipe": ["reach"], "start": [0.1], "frames": ["AAAA"], "length": 9, "rollout": [0.5]}

    def found(**changes: Any) -> list[str]:
        return list(compare({"dial": [then] * 5}, {"dial": [{**then, **changes}] * 3 + [then] * 2}))

    assert not found()
    assert not found(start=[0.1003], frames=["AAAD"], length=12, rollout=[0.505])
    assert found(recipe=["pour"]) == ["dial: recipe of 3 of 5 episodes"]
    assert found(frames=["AAAE"]) == ["dial: frames of 3 of 5 episodes, by 4"]
    assert found(length=13) == ["dial: length of 3 of 5 episodes, by 4"]
    assert found(rollout=[0.52], start=[0.2]) == [
        "dial: start of 3 of 5 episodes, by 0.1",
        "dial: rollout of 3 of 5 episodes, by 0.02",
    ]


def test_a_minority_of_the_episodes_may_take_another_course() -> None:
    then: Episode = {"start": [0.1], "ends": [4, 9]}
    now = [{"start": [0.1], "ends": [30]}] * 2 + [then] * 3
    assert not list(compare({"bins": [then] * 5}, {"bins": now}))
    assert list(compare({"bins": [then]}, {"bins": now[:1]}))


def read(world: str) -> dict[str, Any]:
    document: dict[str, Any] = json.loads(path_of(world).read_text())
    return document


def path_of(world: str) -> Path:
    return FOLDER / f"{world}.json"


def version_of(world: str) -> str:
    (version,) = {tasks()[name].world_version for name in WORLDS[world]}
    return version


def record(world: str) -> Cases:
    """Returns how a world behaves: episodes of each task, and one under each condition."""
    cases = {}
    for task in (tasks()[name] for name in WORLDS[world]):
        with closing(task.make()) as made:
            seeds = range(FEWER_EPISODES.get(task.name, EPISODES))
            cases[task.name] = [episode(task, made, seed) for seed in seeds]
        for condition in task.own_conditions if task.name in UNDER_CONDITIONS else ():
            cases[f"{task.name} {condition.name}"] = [episode_under(task, condition.name)]
    return cases


def episode(task: TaskDefinition, world: World, seed: int) -> Episode:
    """Returns recipe, start and first frames of an episode, a demonstration, and the state after random actions."""
    rng = np.random.default_rng(seed)
    recipe = draw_recipe(task, rng)
    found = {"recipe": list(recipe), **begin(world, recipe, rng, world.spec.cameras)}
    if task.spec.has_expert:
        found |= demonstrate(world, recipe, rng)
    rng = np.random.default_rng(seed)
    world.reset(rng, recipe=draw_recipe(task, rng))
    policy = SmoothRandomPolicy(world.spec.action, rng)
    for _ in range(ROLLOUT_STEPS):
        world.step(policy.act().action)
    return found | {"rollout": rounded(world.truth().state)}


def episode_under(task: TaskDefinition, condition: str) -> Episode:
    """Returns start, first frame and number of timesteps of a demonstration under a condition."""
    rng = np.random.default_rng(0)
    with closing(build(task, [condition])) as world:
        recipe = draw_recipe(task, rng)
        found = begin(world, recipe, rng, world.spec.cameras[:1])
        ends = demonstrate(world, recipe, rng)["ends"] if task.spec.has_expert else [0]
    return found | {"length": ends[-1]}


def draw_recipe(task: TaskDefinition, rng: np.random.Generator) -> tuple[str, ...]:
    """Returns a short recipe."""
    fewest, most = task.recipes.lengths(task.spec.skills)
    return task.recipes.draw(rng, task.spec.skills, fewest=fewest, most=min(most, MOST_SKILLS))


def begin(world: World, recipe: Sequence[str], rng: np.random.Generator, cameras: Sequence[Camera]) -> dict[str, Any]:
    """Begins an episode; returns its true state and its frames."""
    world.reset(rng, recipe=recipe)
    frames = [world.render(each.name, height=each.height, width=each.width) for each in cameras]
    return {"start": rounded(world.truth().state), "frames": [coarse(frame) for frame in frames]}


def demonstrate(world: World, recipe: Sequence[str], rng: np.random.Generator) -> dict[str, Any]:
    """Returns the segments of a demonstration and its mean absolute action."""
    expert = expert_of(world)(recipe, rng)
    made = record_episode(world, expert, cameras=(), max_steps=world.spec.max_episode_steps)
    ends = [*(np.flatnonzero(np.diff(made.labels)) + 1).tolist(), len(made.labels)]
    return {
        "skills": [int(made.labels[end - 1]) for end in ends],
        "ends": ends,
        "success": made.success,
        "action": rounded(np.abs(made.actions).mean(axis=0)),
    }


def rounded(values: npt.NDArray[np.float64]) -> list[float]:
    return [round(float(value), DECIMALS) + 0.0 for value in values]


def coarse(frame: Frame) -> str:
    """Returns the means of a frame's blocks, uint8 (BLOCKS, BLOCKS, C), in base 64."""
    rows = [part.mean(axis=0) for part in np.array_split(frame, BLOCKS)]
    means = [[part.mean(axis=0) for part in np.array_split(row, BLOCKS)] for row in rows]
    return base64.b64encode(np.round(means).astype(np.uint8).tobytes()).decode()


def compare(recorded: Cases, found: Cases) -> Iterator[str]:
    """Yields what differs."""
    if recorded.keys() != found.keys():
        yield f"the recorded tasks and conditions are {', '.join(recorded)}"
        return
    for case, before in recorded.items():
        for part in before[0]:
            by = [difference(part, then[part], now[part]) for then, now in zip(before, found[case], strict=True)]
            apart = [each for each in by if each > TOLERANCES.get(part, 0)]
            if len(apart) > (len(by) - 1) // 2 * (part in CHAOTIC):
                largest = f", by {max(apart):.2g}" if max(apart) < math.inf else ""
                yield f"{case}: {part} of {len(apart)} of {len(by)} episodes{largest}"


def difference(part: str, then: Any, now: Any) -> float:
    """Returns the largest difference of numbers of one shape, else 0 for equal values and infinity for others."""
    if part == "frames":
        then, now = ([float(each) for frame in frames for each in base64.b64decode(frame)] for frames in (then, now))
    if part in TOLERANCES and np.shape(then) == np.shape(now):
        return float(np.abs(np.subtract(then, now)).max())
    return 0.0 if then == now else math.inf


def save(world: str) -> None:
    """Writes the record of a world; of its version keeps what is there. Each episode is on a line of its own."""
    before = read(world) if path_of(world).is_file() else {"version": "", "cases": {}}
    kept = before["cases"] if before["version"] == version_of(world) else {}
    cases = [
        f"{json.dumps(case)}: [\n" + ",\n".join(map(json.dumps, kept.get(case, episodes))) + "\n]"
        for case, episodes in record(world).items()
    ]
    document = f'{{"version": "{version_of(world)}", "cases": {{\n' + ",\n".join(cases) + "\n}}\n"
    path_of(world).write_text(document)


if __name__ == "__main__":
    for name in WORLDS:
        save(name)
