"""Sawyer's hand and two pucks; and pictures of pucks, blocks and a tray in which all criteria of table 4.1 occur."""

from collections.abc import Mapping
from contextlib import closing
from functools import cache

import mujoco
import numpy as np
import numpy.typing as npt
import pytest

from freerein.criteria import View, criteria
from freerein.errors import InvalidInput
from freerein_sim.worlds.episodes import record_episode, record_expert
from freerein_sim.worlds.predicates import States
from freerein_sim.worlds.push import TASKS, initial_states, scene
from freerein_sim.worlds.push.criteria import CLOSE_M, CRITERIA, Criterion
from freerein_sim.worlds.push.predicates import is_behind
from freerein_sim.worlds.push.simulation import PushWorld
from freerein_sim.worlds.push.things import EVERYTHING, OBJECT_M
from freerein_sim.worlds.world import expert_of

BY_NAME = {task.name: task for task in TASKS}
PUSH, SCATTER = BY_NAME["push"], BY_NAME["push.scatter"]
RELATIONS = [each for each in SCATTER.predicates if each.name.startswith("relation/")]
SHARES = {
    "left-of": 0.95,
    "right-of": 0.95,
    "on-top-of": 0.30,
    "below": 0.30,
    "in-front-of": 0.94,
    "behind": 0.94,
    "close-to": 0.90,
    "apart-from": 0.94,
    "inside-of": 0.43,
    "in-between": 0.66,
}
"""Those of the service's README."""

NOTHING = np.zeros(2, np.float32)
ON_TABLE = {"puck": 0.0175, "block": 0.025, "tray": 0.017}
STARTS = 400


def begin(name: str, seed: int = 0) -> PushWorld:
    world = BY_NAME[name].make()
    assert isinstance(world, PushWorld)
    world.reset(np.random.default_rng(seed))
    return world


def state_of(places: Mapping[str, tuple[float, ...]]) -> npt.NDArray[np.float64]:
    """Returns the true state of a scene with things on the table at (x, y), or at (x, y, z); others are not on show."""
    found = [0.0, 0.0, 0.1]
    for thing, parked in zip(EVERYTHING, initial_states.PARKED_M, strict=True):
        at = places.get(thing.name, tuple(parked))
        found += [*at, *(() if len(at) == 3 else (ON_TABLE[thing.kind],)), 1, 0, 0, 0]
    return np.array(found)


def true_captions(state: npt.NDArray[np.float64]) -> set[str]:
    return {each.text for each in RELATIONS if each.holds(state[None, None])[0, 0]}


def shares(states: States) -> dict[str, float]:
    """Returns in which share of scenes, float64 (N, S), a criterion holds of some things."""
    found = {criterion.name: np.zeros(len(states), np.bool_) for criterion in CRITERIA}
    for each in RELATIONS:
        name = next(name for name in found if f"-{name}-" in each.name)
        found[name] |= each.holds(states[:, None])[:, 0]
    return {name: float(holds.mean()) for name, holds in found.items()}


@cache
def scattered() -> States:
    """Returns the true states of scattered starts, float64 (STARTS, S), all things unturned."""
    starts = [initial_states.scatter(np.random.default_rng(seed)) for seed in range(STARTS)]
    unturned = np.tile([1.0, 0, 0, 0], (len(EVERYTHING), 1))
    return np.stack([np.append(start.hand, np.hstack([start.places, unturned])) for start in starts])


def test_there_is_a_task_for_each_ordered_pair_of_colours_and_push_is_the_dissertations() -> None:
    assert PUSH.goal_text == "a blue puck close to a yellow puck"
    assert BY_NAME["push.red-close-to-green"].goal_text == "a red puck close to a green puck"
    assert len({task.goal_text for task in TASKS}) == len(TASKS) == 13


BLUE, YELLOW = "blue-puck", "yellow-puck"


@pytest.mark.parametrize(
    ("places", "true", "false"),
    [
        ({BLUE: (0, -0.03), YELLOW: (0, 0.03)}, "to the left of|close to", "apart from|behind|in front of"),
        ({BLUE: (0, 0.03), YELLOW: (0, -0.03)}, "to the right of|close to", "to the left of"),
        ({BLUE: (0, -0.02), YELLOW: (0.2, 0)}, "behind|apart from", "to the left of|close to"),
        ({BLUE: (0.05, 0), YELLOW: (0, 0)}, "in front of|close to", "on top of|behind"),
        ({BLUE: (0, 0.01, 0.0525), YELLOW: (0, 0)}, "on top of|close to", "below|to the right of"),
        ({BLUE: (0, 0), YELLOW: (0.01, 0, 0.0525)}, "below|close to", "on top of|behind"),
        ({BLUE: (0, 0, 0.0525), YELLOW: (0, 0.052)}, "close to|to the left of", "on top of"),
        ({BLUE: (0, 0), YELLOW: (0, CLOSE_M + 0.001)}, "apart from", "close to"),
    ],
)
def test_a_criterion_of_a_pair_holds_of_pucks_that_are_placed_so(
    places: dict[str, tuple[float, ...]], true: str, false: str
) -> None:
    captions = true_captions(state_of(places))

    assert {f"a blue puck {words} a yellow puck" for words in true.split("|")} <= captions
    assert not {f"a blue puck {words} a yellow puck" for words in false.split("|")} & captions


@pytest.mark.parametrize(
    ("at", "inside"),
    [((0.03, 0.03, 0.029), True), ((0, 0, 0.029), True), ((0, 0, 0.1), False), ((0.085, 0, 0.025), False)],
    ids=["in a corner", "in the middle", "held above", "outside"],
)
def test_a_block_is_inside_of_the_tray_below_its_rim(at: tuple[float, ...], inside: bool) -> None:
    captions = true_captions(state_of({"red-block": at, "tray": (0, 0)}))

    assert ("a red block inside of a tray" in captions) is inside


def test_of_three_things_one_is_in_between_and_hidden_things_are_in_no_relation() -> None:
    places = {"red-block": (0.1, 0.0), "tray": (0.0, 0.1), "blue-puck": (-0.1, -0.1)}
    captions = true_captions(state_of(places))

    assert {each for each in captions if "in between" in each} == {"a red block in between a blue puck and a tray"}
    assert not {each for each in captions if "yellow" in each or "green" in each}
    level = true_captions(state_of({**places, "red-block": (0.1, 0.09)}))
    assert not [each for each in level if "in between" in each]


def test_criteria_of_one_group_exclude_each_other() -> None:
    holds = {each: each.holds(scattered()[:, None])[:, 0] for each in RELATIONS if each.group}
    together: dict[str, npt.NDArray[np.int64]] = {}
    for each, found in holds.items():
        together[each.group] = together.get(each.group, 0) + found.astype(np.int64)

    assert max(found.max() for found in together.values()) == 1


def test_each_criterion_holds_in_a_fair_share_of_scattered_scenes() -> None:
    found = shares(scattered())

    assert found == pytest.approx(SHARES, abs=0.08)
    assert min(found.values()) > 0.1


def test_nothing_scattered_begins_inside_anything_else_and_everything_stays_where_it_lies() -> None:
    with closing(begin("push.scatter")) as world:
        model = scene.build(EVERYTHING).model
        data, before, after = mujoco.MjData(model), [], []
        for seed in range(40):
            world.reset(np.random.default_rng(seed))
            before.append(world.truth().state)
            data.qpos[:] = before[-1]
            mujoco.mj_forward(model, data)
            assert data.contact.dist.min(initial=0.0) > -1e-6, f"seed {seed}"
            for _ in range(SCATTER.spec.max_episode_steps):
                assert not world.step(NOTHING).terminated
            after.append(world.truth().state)
    assert shares(np.stack(before)) == shares(np.stack(after))
    assert np.abs(np.stack(after) - before)[:, :3].max() < 0.001


def test_pucks_begin_apart_where_the_hand_comes_behind_them_and_it_touches_none() -> None:
    starts = [initial_states.pair(np.random.default_rng(seed)) for seed in range(STARTS)]
    places, hands = (np.stack([each.places for each in starts]), np.stack([each.hand for each in starts]))

    assert (np.linalg.norm(places[:, 0] - places[:, 1], axis=-1) > CLOSE_M + 0.02).all()
    assert (np.abs(places[..., :2]) < scene.HAND_M - 0.06).all()
    assert (np.linalg.norm((places - hands[:, None])[..., :2], axis=-1) > 0.08).all()


def test_the_expert_pushes_the_first_puck_close_to_the_second_from_any_start() -> None:
    with closing(begin("push")) as world:
        for seed in range(20):
            shown = record_expert(world, (), np.random.default_rng(seed))
            blue, yellow = (world.place(thing) for thing in world.things)

            assert shown.success, f"seed {seed}"
            assert len(shown.actions) < PUSH.spec.max_episode_steps
            assert world.truth().reward == 1.0
            assert np.linalg.norm(blue - yellow) < CLOSE_M


def test_an_expert_that_settles_is_seen_where_it_is_done() -> None:
    with closing(begin("push")) as world:
        short, long = (
            record_expert(world, (), np.random.default_rng(0), cameras=world.spec.cameras[:1], settle=settle)
            for settle in (0, 2)
        )
        count = len(short.actions)
        assert len(long.actions) == len(long.labels) == count + 2
        np.testing.assert_array_equal(long.actions[:count], short.actions)
        np.testing.assert_array_equal(long.actions[count:], np.zeros((2, 2), np.float32))
        assert long.success
        camera = world.spec.cameras[0].name
        np.testing.assert_array_equal(long.frames[camera][:count], short.frames[camera])
        assert world.truth().success


def test_the_expert_goes_around_a_puck_that_has_slipped_aside() -> None:
    with closing(begin("push")) as world:
        for seed in range(6):
            world.reset(np.random.default_rng(seed))
            expert = expert_of(world)((), np.random.default_rng(seed))
            while (chosen := expert.act()) is not None and chosen.skill == 0:
                world.step(chosen.action)
            ahead = (world.place(world.things[1]) - world.place(world.things[0]))[:2]
            for _ in range(2):
                world.step((np.array([-ahead[1], ahead[0]]) / np.abs(ahead).max()).astype(np.float32))
            has_slipped = not is_behind(world.hand, *(world.place(thing) for thing in world.things))
            finished = record_episode(world, expert, cameras=(), max_steps=60)

            assert has_slipped
            assert world.truth().success, f"seed {seed}"
            assert (finished.labels == 1).all()


def test_the_hand_follows_its_actions_within_its_bounds_and_does_not_wind_up() -> None:
    with closing(begin("push")) as world:
        world.reset(np.random.default_rng(1))
        before = world.hand
        world.step(np.array([0.2, -0.2], np.float32))
        world.step(NOTHING)
        moved = world.hand - before
        for _ in range(15):
            world.step(np.array([1, 0], np.float32))
        furthest = world.hand[0]
        world.step(np.array([-1, 0], np.float32))

        assert moved == pytest.approx([0.01, -0.01, 0], abs=0.001)
        assert furthest == pytest.approx(scene.HAND_M[0], abs=0.002)
        assert world.hand[0] < furthest - 0.03


def test_an_episode_ends_when_a_thing_leaves_the_table() -> None:
    with closing(begin("push")) as world:
        snapshot = bytearray(world.snapshot())
        first_x = 8 + 8 * (1 + 3)  # after the header, the time and the hand
        snapshot[first_x : first_x + 8] = np.array([0.3], "<f8").tobytes()
        world.restore(bytes(snapshot))

        assert world.step(NOTHING).terminated


def test_another_recipe_is_refused() -> None:
    with closing(begin("push")) as world:
        for recipe in (("push",), ("push", "reach"), ("reach", "reach")):
            with pytest.raises(InvalidInput, match="all of the recipe reach, push, in order"):
                world.reset(np.random.default_rng(0), recipe=recipe)
    with pytest.raises(InvalidInput, match="all of the recipe reach, push, in order; got push"):
        PUSH.recipes.lengths(("push",))


@pytest.mark.parametrize("size", [48, 64])
def test_both_pucks_can_be_told_by_colour_from_some_camera(size: int) -> None:
    with closing(begin("push")) as world:
        for seed in range(10):
            world.reset(np.random.default_rng(seed))
            views = [world.render(each.name, height=size, width=size).astype(int) for each in PUSH.spec.cameras]
            red, green, blue = np.moveaxis(np.stack(views), -1, 0)  # (3, H, W) each

            assert ((blue > 100) & (red < 60)).sum(axis=(1, 2)).max() >= 10
            assert ((red > 130) & (green > 100) & (blue < 60)).sum(axis=(1, 2)).max() >= 10


BESIDE_LIMITS = {"on-top-of": 0.15, "below": 0.15, "close-to": 0.05, "apart-from": 0.05, "inside-of": 0.15}
"""Object widths from the limit of a caption within which the oracle may have its own; half a width for sides."""


@pytest.mark.parametrize("criterion", CRITERIA, ids=lambda criterion: criterion.name)
def test_captions_of_true_places_judge_as_the_oracle_does_but_for_their_limits(criterion: Criterion) -> None:
    rng, count = np.random.default_rng(0), 20_000
    places = rng.uniform(-4, 4, (3, count, 3)) * (1, 1, 0)  # x, y, z in object widths
    is_stacked = rng.random(count) < (0 if criterion.name == "inside-of" else 0.5)
    on_second = places[1] + np.append(rng.uniform(-0.9, 0.9, (count, 2)), rng.choice((0.7, 1.0), (count, 1)), axis=1)
    places[0] = np.where(is_stacked[:, None], on_second, places[0])
    if criterion.name == "below":
        places[:2] = places[1::-1].copy()
    x, y, z = np.moveaxis(places[: len(criterion.kinds)], 2, 0).swapaxes(1, 2)  # (count, things)
    seen = {View.FRONT: (y, -z), View.SIDE: (x, -z), View.TILTED: (y, x)}  # from far away, the last from above
    name = "close_to" if criterion.name == "apart-from" else criterion.name.replace("-", "_")
    caption = criteria(container_width=2.4)[name]
    margin = caption.margin(np.stack(seen[caption.view], axis=2)) * (-1 if criterion.name == "apart-from" else 1)
    is_clear = np.abs(margin) > BESIDE_LIMITS.get(criterion.name, 0.55)

    holds = criterion.holds(*(OBJECT_M * places[: len(criterion.kinds)]))
    assert (holds[is_clear] == (margin[is_clear] > 0)).all()
    assert 100 < holds[is_clear].sum() < is_clear.sum() - 100
