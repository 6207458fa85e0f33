from contextlib import closing
from itertools import permutations

import numpy as np
import pytest

from freerein.errors import InvalidInput
from freerein_sim.worlds.blocks import TASKS, initial_states
from freerein_sim.worlds.blocks.goals import GOAL_RELATIONS, BlockGoal
from freerein_sim.worlds.blocks.relations import BLOCK_M, BlockRelation, holds, is_related, is_visible
from freerein_sim.worlds.blocks.simulation import BlocksWorld
from freerein_sim.worlds.blocks.spec import COLOURS
from freerein_sim.worlds.episodes import RecordedEpisode, record_expert
from freerein_sim.worlds.varied_world import build
from freerein_sim.worlds.world import World

BY_NAME = {task.name: task for task in TASKS}
NOTHING = np.zeros(3, np.float32)
VELOCITIES = 8 + 8 * (1 + 4 + 7 * len(COLOURS))
"""Byte of a snapshot at which velocities begin: after the header, the time, four joints and the blocks' poses."""
RED_Y = 8 + 8 * (1 + 4 + 1)
"""Byte at which the red block's y lies."""


def begin(name: str, seed: int = 0) -> World:
    world = BY_NAME[name].make()
    world.reset(np.random.default_rng(seed))
    return world


def show(world: World, seed: int, skills: tuple[str, ...]) -> RecordedEpisode:
    return record_expert(world, skills, np.random.default_rng(seed))


def tamper(world: World, offset: int, value: float) -> bytes:
    snapshot = bytearray(world.snapshot())
    snapshot[offset : offset + 8] = np.array([value], "<f8").tobytes()
    return bytes(snapshot)


def test_there_is_a_goal_task_for_each_relation_of_each_ordered_pair_of_colours() -> None:
    expected = {
        f"blocks.{first}-{relation}-{second}"
        for first, second in permutations(COLOURS, 2)
        for relation in ("left-of", "right-of", "on-top-of")
    }

    assert set(BY_NAME) == {"blocks", "blocks.scatter"} | expected
    assert BY_NAME["blocks.red-left-of-green"].goal_text == "a red block to the left of a green block"
    assert BY_NAME["blocks.blue-on-top-of-red"].goal_text == "a blue block on top of a red block"
    assert BY_NAME["blocks"].goal_text == ""


@pytest.mark.parametrize(
    ("relation", "offset", "expected"),
    [
        (BlockRelation.LEFT_OF, (0, -0.07, 0), True),
        (BlockRelation.LEFT_OF, (0, -0.05, 0), True),
        (BlockRelation.LEFT_OF, (0, -0.0495, 0), True),
        (BlockRelation.LEFT_OF, (0, -0.0945, 0), True),
        (BlockRelation.LEFT_OF, (0, -0.0955, 0), False),
        (BlockRelation.LEFT_OF, (0, 0.05, 0), False),
        (BlockRelation.LEFT_OF, (0, 0.07, 0), False),
        (BlockRelation.LEFT_OF, (0.07, -0.07, 0), False),
        (BlockRelation.LEFT_OF, (0, -0.07, 0.01), False),
        (BlockRelation.RIGHT_OF, (0, 0.07, 0), True),
        (BlockRelation.RIGHT_OF, (0, 0.0495, 0), True),
        (BlockRelation.RIGHT_OF, (0, -0.07, 0), False),
        (BlockRelation.ON_TOP_OF, (0, 0.01, 0.05), True),
        (BlockRelation.ON_TOP_OF, (0, 0.01, 0.047), True),
        (BlockRelation.ON_TOP_OF, (0, 0.03, 0.05), False),
        (BlockRelation.ON_TOP_OF, (0, 0.01, 0.06), False),
        (BlockRelation.ON_TOP_OF, (0, 0.01, -0.05), False),
        (BlockRelation.BELOW, (0, 0.01, -0.05), True),
        (BlockRelation.APART_FROM, (0, 0.1, 0), True),
    ],
)
def test_a_relation_holds_only_where_the_block_lies_as_if_placed(
    relation: BlockRelation, offset: tuple[float, float, float], expected: bool
) -> None:
    other = np.array([0.0, 0.02, 0.025])

    assert bool(holds(relation, other + offset, other)) is expected


def test_every_pair_of_blocks_is_in_exactly_one_relation_and_a_goal_holds_only_in_its_own() -> None:
    first, second = np.random.default_rng(0).uniform(-0.15, 0.15, size=(2, 500, 4, 3)) * (0.2, 1, 1)
    related = np.stack([is_related(each, first, second) for each in BlockRelation])
    one_by_one = [bool(is_related(BlockRelation.LEFT_OF, *pair)) for pair in zip(first[0], second[0], strict=True)]

    assert (related.sum(axis=0) == 1).all()
    assert related.any(axis=(1, 2)).all()
    assert one_by_one == is_related(BlockRelation.LEFT_OF, first, second)[0].tolist()
    for each, true in zip(BlockRelation, related, strict=True):
        assert not (holds(each, first, second) & ~true).any()


def test_blocks_pressed_together_by_the_gripper_count_as_beside() -> None:
    colours = ("red", "green")
    with closing(begin("blocks.red-left-of-green")) as world:
        assert isinstance(world, BlocksWorld)
        red, green = (world.position(colour) for colour in colours)
        assert red[1] < green[1]
        for y, z in ((red[1] - 0.07, 0.15), (red[1] - 0.07, 0.05)):
            for _ in range(25):
                world.step(np.array([*np.clip((np.array([y, z]) - world.set_point[:2]) / 0.05, -1, 1), -1], np.float32))
        while world.position("green")[1] < green[1] + 0.01:
            world.step(np.array([0.15, 0, -1], np.float32))
        for _ in range(10):
            world.step(NOTHING)
        gap_m = world.position("green")[1] - world.position("red")[1] - 0.05

        assert -0.002 < gap_m < 0
        assert world.truth().success


def test_a_goal_whose_block_is_in_the_hand_earns_nothing() -> None:
    with closing(begin("blocks.red-left-of-green")) as world:
        assert isinstance(world, BlocksWorld)
        expert, near = world.expert((), np.random.default_rng(0)), 0
        while (planned := expert.act()) is not None:
            world.step(planned.action)
            red, green = (world.position(colour) for colour in ("red", "green"))
            if red[2] > 0.04 and is_related(BlockRelation.LEFT_OF, red, green):
                near += 1
                assert not world.truth().success

    assert near > 0


@pytest.mark.parametrize("count", [2, 3, 4])
@pytest.mark.parametrize("interval_m", [initial_states.SEEN_M, initial_states.UNSEEN_M], ids=["seen", "unseen"])
@pytest.mark.parametrize("relation", GOAL_RELATIONS)
def test_the_blocks_of_a_goal_begin_apart_within_their_intervals_in_either_order_and_others_leave_room(
    relation: BlockRelation, interval_m: float, count: int
) -> None:
    rng, goal = np.random.default_rng(0), BlockGoal("green", relation, "blue")
    blocks = np.stack(
        [initial_states.pair(rng, goal=goal, count=count, interval_m=interval_m).blocks for _ in range(400)]
    )
    first, second = blocks[:, 1], blocks[:, 3]
    left, right = np.sort([first[:, 1], second[:, 1]], axis=0)
    on_show = is_visible(blocks)
    distances = np.abs(blocks[:, :, None, 1] - blocks[:, None, :, 1])
    both = on_show[:, :, None] & on_show[:, None] & ~np.eye(4, dtype=bool)

    assert is_related(BlockRelation.APART_FROM, first, second).all()
    assert (np.abs(left + 0.07) <= interval_m / 2).all()
    assert (np.abs(right - 0.07) <= interval_m / 2).all()
    assert np.ptp(left) > 0.9 * interval_m
    assert 0.45 < (first[:, 1] < second[:, 1]).mean() < 0.55
    assert (on_show.sum(axis=1) == count).all()
    assert distances[both].min() > BLOCK_M + 0.005
    assert on_show[:, [0, 2]].mean() == pytest.approx((count - 2) / 2)
    assert count != 3 or 0.45 < on_show[:, 0].mean() < 0.55
    if relation is not BlockRelation.ON_TOP_OF:
        place = second[:, None, 1] + (-0.071 if relation is BlockRelation.LEFT_OF else 0.071)
        bystanders = blocks[:, [0, 2], 1][on_show[:, [0, 2]]]
        assert (np.abs(bystanders - np.repeat(place, count - 2)) > 0.077).all()


@pytest.mark.parametrize("relation", ["left-of", "right-of", "on-top-of"])
def test_the_expert_reaches_goals_from_unseen_starts_among_four_blocks(relation: str) -> None:
    with closing(build(BY_NAME[f"blocks.green-{relation}-yellow"], ("start-unseen", "blocks-4"))) as world:
        for seed in range(5):
            assert show(world, seed, ("move-green",)).success
            assert world.truth().success


@pytest.mark.parametrize(
    ("condition", "held", "near"),
    [("start-on-the-way", (0.23, 0.43), (0.4, 0.65)), ("start-near", (0, 0), (0.12, 0.3))],
)
def test_the_gripper_begins_near_the_first_block_or_holds_it_and_nothing_falls_or_is_pushed_far(
    condition: str, held: tuple[float, float], near: tuple[float, float]
) -> None:
    rng, still = np.random.default_rng(0), np.zeros(3, np.float32)
    is_held, distances = [], []
    with closing(build(BY_NAME["blocks.green-left-of-yellow"], (condition, "blocks-4"))) as world:
        for _ in range(150):
            world.reset(rng)
            before = {colour: world.position(colour) for colour in world.visible_colours}
            is_held.append(before["green"][2] > 0.03)
            distances.append(np.linalg.norm(world.gripper - before["green"][1:]))
            for _ in range(3):
                world.step(still)
            assert all(np.abs(world.position(colour) - place).max() < 0.03 for colour, place in before.items())

    assert len(before) == 4
    assert held[0] <= np.mean(is_held) <= held[1]
    assert near[0] < np.mean(np.less(distances, 0.08)) < near[1]


@pytest.mark.parametrize("count", [2, 3])
def test_free_play_with_fewer_blocks_shows_those_that_its_recipe_names(count: int) -> None:
    recipe = ("move-blue", "move-green", "move-red")[:count]
    drawn = set()
    with closing(build(BY_NAME["blocks"], (f"blocks-{count}",))) as world:
        for seed in range(8):
            assert show(world, seed, recipe).success
            assert world.visible_colours == tuple(colour for colour in COLOURS if f"move-{colour}" in recipe)
            world.reset(np.random.default_rng(seed), recipe=recipe[:1])
            assert "blue" in world.visible_colours
            drawn.add(world.visible_colours)
        hidden = next(colour for colour in COLOURS if colour not in world.visible_colours)
        with pytest.raises(InvalidInput, match=f"{hidden} is hidden"):
            world.expert((f"move-{hidden}",), np.random.default_rng(0))
        with pytest.raises(InvalidInput, match=f"at most {count} blocks"):
            world.reset(np.random.default_rng(0), recipe=world.spec.skills)

    assert len(drawn) == 3


def test_the_expert_moves_every_named_block_and_no_other() -> None:
    rng = np.random.default_rng(0)
    with closing(begin("blocks")) as world:
        assert isinstance(world, BlocksWorld)
        for seed in range(6):
            skills = tuple(rng.permutation(world.spec.skills)[: rng.integers(2, 5)].tolist())
            world.reset(np.random.default_rng(seed))
            before = {colour: world.position(colour) for colour in COLOURS}
            shown = show(world, seed, skills)
            moved = {
                f"move-{colour}" for colour in COLOURS if abs(world.position(colour) - before[colour]).max() > 0.03
            }

            assert shown.success, f"seed {seed}"
            assert moved == set(skills), f"seed {seed}"


def test_the_recipe_changes_nothing_that_can_be_seen() -> None:
    with closing(begin("blocks")) as world:
        starts = set()
        for recipe in ((), ("move-red",), ("move-blue", "move-green")):
            world.reset(np.random.default_rng(5), recipe=recipe)
            starts.add(world.snapshot())

    assert len(starts) == 1


def test_every_block_can_be_seen_from_the_front_at_64_pixels() -> None:
    with closing(begin("blocks")) as world:
        image = world.render("front", height=64, width=64).astype(int)
    red, green, blue = np.moveaxis(image, -1, 0)

    assert ((red > 120) & (green < 60) & (blue < 60)).sum() >= 30
    assert ((green > 100) & (red < 80) & (blue < 80)).sum() >= 30
    assert ((red > 150) & (green > 120) & (blue < 80)).sum() >= 30
    assert ((blue > 120) & (red < 80) & (green < 110)).sum() >= 30


def test_the_gripper_stays_within_its_bounds() -> None:
    with closing(begin("blocks")) as world:
        for action in ((1, 1, 1), (-1, -1, -1)):
            for _ in range(20):
                world.step(np.array(action, np.float32))
            y, z = world.truth().state[:2]

            assert -0.23 < y < 0.23
            assert 0.03 < z < 0.27


def test_a_free_gripper_moves_by_the_scale_of_its_action() -> None:
    with closing(begin("blocks.red-left-of-green")) as world:
        before = world.truth().state[:2]
        world.step(np.array([0.4, 0.4, 0], np.float32))
        for _ in range(6):
            world.step(NOTHING)

        assert world.truth().state[:2] - before == pytest.approx([0.02, 0.02], abs=0.002)


def test_a_blocked_gripper_does_not_wind_up() -> None:
    with closing(begin("blocks")) as world:
        assert isinstance(world, BlocksWorld)
        for _ in range(40):
            world.step(np.array([0, -1, -1], np.float32))
        low = world.gripper[1]
        for _ in range(4):
            world.step(np.array([0, 1, 0], np.float32))

        assert world.gripper[1] > low + 0.1


def test_an_episode_ends_when_a_block_leaves_the_table() -> None:
    with closing(begin("blocks")) as world:
        world.restore(tamper(world, RED_Y, 0.5))
        outcomes = [world.step(NOTHING) for _ in range(8)]

    assert outcomes[-1].terminated
    assert not outcomes[-1].diverged


@pytest.mark.fault("M5")
def test_divergence_is_reported_and_never_reset_away() -> None:
    with closing(begin("blocks")) as world:
        world.restore(tamper(world, VELOCITIES, 1e12))
        outcome = world.step(NOTHING)
        gone = abs(world.truth().state[0]) > 1
        world.reset(np.random.default_rng(0))

        assert outcome.terminated
        assert outcome.diverged
        assert gone
        assert not world.step(NOTHING).diverged


def test_a_snapshot_that_is_not_finite_is_refused() -> None:
    with closing(begin("blocks")) as world, pytest.raises(InvalidInput, match="finite"):
        world.restore(tamper(world, VELOCITIES, np.nan))


def test_worlds_of_different_blocks_refuse_each_others_snapshots() -> None:
    with closing(begin("blocks")) as four, closing(begin("blocks.red-left-of-green")) as two:
        assert four.fingerprint != two.fingerprint
        with pytest.raises(InvalidInput, match="snapshot of this world"):
            two.restore(four.snapshot())
