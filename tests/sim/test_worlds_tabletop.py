from contextlib import closing

import numpy as np
import numpy.typing as npt
import pytest

from freerein.errors import InvalidInput
from freerein_sim.worlds.conformance.rollouts import demonstrate
from freerein_sim.worlds.episodes import record_episode
from freerein_sim.worlds.predicates import States
from freerein_sim.worlds.tabletop import TASKS
from freerein_sim.worlds.tabletop.demonstrator import Demonstrator
from freerein_sim.worlds.tabletop.motions import Movement
from freerein_sim.worlds.tabletop.predicates import COMPLETED, STATE_NAMES
from freerein_sim.worlds.tabletop.recipes import ReachThenTask
from freerein_sim.worlds.tabletop.simulation import TabletopWorld
from freerein_sim.worlds.tabletop.spec import SPEC
from freerein_sim.worlds.tabletop.things import SCALED, TASK_SKILLS, THINGS, Thing, thing_of
from freerein_sim.worlds.world import World, expert_of

EVERYTHING, ONLY_OWN = TASKS
CAMERA = SPEC.cameras[0]


def begin(task: int, seed: int, skill: str) -> World:
    world = TASKS[task].make()
    world.reset(np.random.default_rng(seed), recipe=("reach", skill))
    return world


def shows(world: World) -> list[str]:
    assert isinstance(world, TabletopWorld)
    return [name for name in SCALED if world.position(name)[0] > -1]


def state_of(length: int, numbers: dict[str, npt.ArrayLike]) -> States:
    """Returns a sequence of states that are 0 but for some numbers, float64 (1, length, S)."""
    states = np.zeros((1, length, len(STATE_NAMES)))
    for name, values in numbers.items():
        states[0, :, STATE_NAMES.index(name)] = values
    return states


def test_a_recipe_is_a_reach_and_one_other_skill_each_as_often() -> None:
    rng, recipes = np.random.default_rng(0), ReachThenTask()
    drawn = [recipes.draw(rng, SPEC.skills, fewest=2, most=2) for _ in range(1000)]

    assert recipes.lengths(SPEC.skills) == (2, 2)
    assert {first for first, _ in drawn} == {"reach"}
    assert all(150 < sum(task == each for _, each in drawn) < 250 for task in TASK_SKILLS)
    assert recipes.draw(rng, ("wipe", "reach"), fewest=2, most=2) == ("reach", "wipe")
    for skills in ((), ("reach",), ("pour", "stir")):
        with pytest.raises(InvalidInput, match="reach and one other skill"):
            recipes.lengths(skills)


def test_other_recipes_are_refused() -> None:
    with closing(begin(0, 0, "pour")) as world:
        for recipe in (("reach",), ("pour",), ("pour", "reach"), ("reach", "reach"), ("reach", "pour", "stir")):
            with pytest.raises(InvalidInput, match="reach and then one other skill"):
                world.reset(np.random.default_rng(0), recipe=recipe)
            with pytest.raises(InvalidInput, match="reach and then one other skill"):
                expert_of(world)(recipe, np.random.default_rng(0))


def test_the_start_is_the_same_whatever_follows_and_everything_is_on_show() -> None:
    frames = []
    for skill in TASK_SKILLS:
        with closing(begin(0, 3, skill)) as world:
            frames.append(world.render(CAMERA.name, height=CAMERA.height, width=CAMERA.width))
            assert shows(world) == list(SCALED)

    assert all(np.array_equal(frame, frames[0]) for frame in frames)
    assert frames[0].shape == (120, 320, 1)


@pytest.mark.parametrize("thing", THINGS, ids=TASK_SKILLS)
def test_the_other_task_shows_only_what_a_recipe_uses_and_demonstrates_nothing_else(thing: Thing) -> None:
    with closing(begin(1, 0, thing.task)) as world:
        assert set(shows(world)) == {thing.name, thing.used_on}
        for task in set(TASK_SKILLS) - {thing.task}:
            with pytest.raises(InvalidInput, match="must be on show"):
                expert_of(world)(("reach", task), np.random.default_rng(0))


def test_a_fixed_split_at_the_mean_share_is_right_in_825_of_1000_timesteps_whatever_the_task() -> None:
    with closing(begin(0, 0, "pour")) as world:
        assert isinstance(world, TabletopWorld)
        rng = np.random.default_rng(0)
        drawn = [Demonstrator(world, ("reach", THINGS[i % len(THINGS)].task), rng) for i in range(5000)]
    steps, reach_steps = (np.array([getattr(each, name) for each in drawn]) for name in ("steps", "reach_steps"))
    shares = reach_steps / steps
    right = np.minimum(reach_steps, steps / 2) + np.minimum(steps - reach_steps, steps / 2)

    assert (steps.min(), steps.max()) == (80, 100)
    assert 0.15 <= shares.min() < 0.16
    assert 0.84 < shares.max() <= 0.85
    assert shares.mean() == pytest.approx(0.5, abs=0.01)
    assert (right / steps).mean() == pytest.approx(0.825, abs=0.005)
    assert right.sum() / steps.sum() == pytest.approx(0.825, abs=0.005)
    assert all(shares[i :: len(THINGS)].mean() == pytest.approx(0.5, abs=0.025) for i in range(len(THINGS)))


def test_movements_are_from_rest_to_rest_and_take_their_steps() -> None:
    start, end = np.zeros(6), np.array([0.3, 0, 0, 0, 0, 0])
    movement = Movement(start, np.random.default_rng(0))
    movement.go(end)
    poses = np.vstack([start, movement.poses(40)])
    speed = np.diff(poses[:, 0])

    assert poses[-1].tolist() == end.tolist()
    assert speed.max() / speed.mean() == pytest.approx(1.875, rel=0.01)
    assert np.diff(poses[:, 0]).min() >= 0
    assert max(speed[0], speed[-1]) < 0.01 * speed.max()
    for steps in (1, 3, 12):
        assert movement.poses(steps).shape == (steps, 6)
        assert movement.poses(steps)[-1].tolist() == end.tolist()


@pytest.mark.parametrize(("turns", "expected"), [(0.95, False), (1.05, True), (-1.05, True), (3, True)])
def test_a_spoon_has_stirred_after_one_turn_in_the_pot(turns: float, expected: bool) -> None:
    angle = np.linspace(0, 2 * np.pi * turns, 40)
    circle: dict[str, npt.ArrayLike] = {
        "spoon.tip.x": 0.03 * np.cos(angle),
        "spoon.tip.y": 0.03 * np.sin(angle),
        "pot.radius": 0.06,
        "pot.height": 0.07,
    }
    has_stirred = COMPLETED["stir"]

    assert has_stirred(state_of(40, circle))[0, -1] == expected
    assert not has_stirred(state_of(40, circle | {"spoon.tip.z": 0.1})).any()
    assert not has_stirred(state_of(40, circle | {"spoon.tip.x": 0.03})).any()


@pytest.mark.parametrize(("tilt_deg", "expected"), [(60, False), (90, True), (120, True)])
def test_a_cup_has_poured_once_it_was_tilted_over_the_bowl(tilt_deg: float, expected: bool) -> None:
    tilts = np.radians([0, tilt_deg, 0])
    pouring: dict[str, npt.ArrayLike] = {
        "hand.holds": 1,
        "cup.qw": np.cos(tilts / 2),
        "cup.qx": np.sin(tilts / 2),
        "cup.lip.z": 0.1,
        "bowl.radius": 0.06,
    }
    has_poured = COMPLETED["pour"]

    assert has_poured(state_of(3, pouring))[0].tolist() == [False, expected, expected]
    assert not has_poured(state_of(3, pouring | {"bowl.x": 0.1})).any()
    assert not has_poured(state_of(3, pouring | {"hand.holds": 0})).any()


@pytest.mark.parametrize("thing", THINGS, ids=TASK_SKILLS)
def test_a_world_restored_with_a_thing_in_the_hand_goes_on_the_same(thing: Thing) -> None:
    with closing(begin(0, 0, thing.task)) as saved, closing(begin(0, 1, thing.task)) as restored:
        assert isinstance(saved, TabletopWorld)
        demonstrator = saved.expert(("reach", thing.task), np.random.default_rng(0))
        while saved.held is not thing:
            planned = demonstrator.act()
            assert planned is not None
            saved.step(planned.action)
        restored.restore(saved.snapshot())
        for _ in range(10):
            planned = demonstrator.act()
            assert planned is not None
            for world in (saved, restored):
                world.step(planned.action)

        assert restored.snapshot() == saved.snapshot()


def test_without_a_recipe_the_expert_executes_that_of_the_episode_also_after_a_restore() -> None:
    with closing(begin(0, 0, "wipe")) as saved, closing(begin(0, 1, "stack")) as restored:
        restored.restore(saved.snapshot())
        expert = expert_of(restored)((), np.random.default_rng(0))
        episode = record_episode(restored, expert, cameras=(), max_steps=SPEC.max_episode_steps)

    assert episode.success
    assert SPEC.skills[episode.labels[-1]] == "wipe"


def test_a_restored_world_has_the_sizes_and_the_light_of_the_saved_one_and_impossible_ones_are_refused() -> None:
    with closing(begin(0, 1, "pour")) as saved, closing(begin(0, 2, "pour")) as restored:
        snapshot = saved.snapshot()
        before = restored.snapshot()
        for number, value in ((0, 2.0), (40, 1.0), (42, 5.0), (68, 5.0), (68, 0.5)):
            broken = bytearray(snapshot)
            broken[8 * number : 8 * number + 8] = np.array([value], "<f8").tobytes()
            with pytest.raises(InvalidInput, match="a snapshot of this world"):
                restored.restore(bytes(broken))
        assert restored.snapshot() == before
        restored.restore(snapshot)
        one, other = (world.render(CAMERA.name, height=120, width=320) for world in (saved, restored))

        assert np.array_equal(one, other)
        assert restored.truth().state.tobytes() == saved.truth().state.tobytes()


@pytest.mark.parametrize("skill", TASK_SKILLS)
def test_demonstrations_complete_their_own_skills_and_no_others(skill: str) -> None:
    with closing(begin(0, 0, skill)) as world:
        shown = demonstrate(world, ("reach", skill), np.random.default_rng(0))
        episode, states = shown.episode, shown.states[None, :-1]
        reached = int((episode.labels == 0).sum())
        completed = {name for name, holds in COMPLETED.items() if holds(states)[0, -1]}

        assert episode.success
        assert completed == {"reach", skill}
        assert not any(holds(states)[0, 0] for holds in COMPLETED.values())
        assert COMPLETED["reach"](states)[0].tolist() == [t >= reached for t in range(len(episode.labels))]
        assert states[0, reached, STATE_NAMES.index("hand.holds")] == 1 + THINGS.index(thing_of(skill))
