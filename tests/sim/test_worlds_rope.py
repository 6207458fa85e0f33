"""The world `rope`: picks and places, knots by crossings, the experts, and TPS-RPM."""

from collections.abc import Iterator
from contextlib import closing

import numpy as np
import numpy.typing as npt
import pytest

from freerein.errors import InvalidInput
from freerein_sim.worlds.episodes import record_expert
from freerein_sim.worlds.rope import TASKS, initial_states
from freerein_sim.worlds.rope.explorer import RandomDisplacements
from freerein_sim.worlds.rope.knots import crossings, determinant, is_knotted
from freerein_sim.worlds.rope.predicates import is_s_shape
from freerein_sim.worlds.rope.simulation import RopeWorld
from freerein_sim.worlds.rope.spec import KNOT, LINK_M, LINKS, RADIUS_M, REACH_M, S_SHAPE, SPEC
from freerein_sim.worlds.rope.tps_rpm import register
from freerein_sim.worlds.world import expert_of

Numbers = npt.NDArray[np.float64]
VIEW_M = 0.36


@pytest.fixture(scope="module")
def world() -> Iterator[RopeWorld]:
    with closing(TASKS[0].make()) as made:
        assert isinstance(made, RopeWorld)
        yield made


def curve(*, x: Numbers, y: Numbers, z: Numbers | float = 0.0) -> Numbers:
    return np.stack([x, y, np.broadcast_to(z, x.shape)], axis=1)


def turned(headings: Numbers) -> Numbers:
    """Returns the rope's curve with these headings of its links, from the origin: float64 (26, 2)."""
    steps = LINK_M * np.stack([np.cos(headings), np.sin(headings)], axis=1)
    return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])


ALONG = np.linspace(0, 2 * np.pi, 60)[1:-1]
OVERHAND = curve(x=np.sin(ALONG) + 2 * np.sin(2 * ALONG), y=np.cos(ALONG) - 2 * np.cos(2 * ALONG), z=-np.sin(3 * ALONG))
FIGURE_EIGHT = curve(
    x=(2 + np.cos(2 * ALONG)) * np.cos(3 * ALONG), y=(2 + np.cos(2 * ALONG)) * np.sin(3 * ALONG), z=np.sin(4 * ALONG)
)
LOOP = curve(x=np.cos(ALONG * 1.2), y=np.sin(ALONG * 1.2) - 0.3 * ALONG, z=ALONG)
LINE = curve(x=ALONG, y=0 * ALONG)
S = turned(np.pi * np.interp(np.arange(LINKS), (0, LINKS // 2, LINKS - 1), (0, 1, 0)))


@pytest.mark.parametrize(
    ("points", "knotted"),
    [
        (LINE, False),
        (LOOP, False),
        (np.column_stack([S, 0 * S[:, 0]]), False),
        (OVERHAND, True),
        (OVERHAND * [1, 1, -1], True),
        (OVERHAND[::-1], True),
        (OVERHAND * [1, 1, 0] + LOOP * [0, 0, 1], False),
        (FIGURE_EIGHT, True),
    ],
    ids=[
        "line",
        "loop",
        "S",
        "overhand",
        "its mirror image",
        "from its other end",
        "laid down in one go",
        "figure eight",
    ],
)
def test_a_curve_is_knotted_by_its_over_and_undercrossings(points: Numbers, knotted: bool) -> None:
    assert is_knotted(points) is knotted


def test_the_determinant_tells_knots_apart() -> None:
    found = [determinant(crossings(each, join_height=np.inf)) for each in (LINE, OVERHAND, FIGURE_EIGHT)]

    assert found == [1, 3, 5]


def test_an_end_within_a_loop_that_would_slip_out_makes_no_knot() -> None:
    last = int(np.sort(np.concatenate([crossings(OVERHAND).over, crossings(OVERHAND).under]))[-1])
    slipped = OVERHAND[:last]

    assert determinant(crossings(slipped, join_height=np.inf)) != determinant(crossings(slipped, join_height=-np.inf))
    assert not is_knotted(slipped)


def test_an_s_is_the_letter_from_either_end_and_turned_but_not_its_mirror_image() -> None:
    flat = np.column_stack([S, 0 * S[:, 0]])

    assert is_s_shape(flat)
    assert is_s_shape(flat[::-1])
    assert is_s_shape(flat[:, [1, 0, 2]] * [-1, 1, 1])
    assert not is_s_shape(flat * [-1, 1, 1])
    assert not is_s_shape(np.column_stack([turned(np.zeros(LINKS)), np.zeros(LINKS + 1)]))


def test_a_pick_that_misses_or_goes_nowhere_moves_nothing(world: RopeWorld) -> None:
    world.reset(np.random.default_rng(0))
    before = world.snapshot()
    on_rope = world.points[12, :2] / REACH_M
    for action in ((-1, -1, 1, 1), (*on_rope, 0, 0)):
        world.step(np.array(action, np.float32))

    assert world.snapshot() == before


def test_a_pick_carries_the_rope_by_the_displacement_and_lays_it_down(world: RopeWorld) -> None:
    world.reset(np.random.default_rng(0), recipe=(KNOT,))
    pick = world.points[:2, :2].mean(axis=0)
    way = np.array([-pick[1], pick[0]]) / np.linalg.norm(pick) * 0.1
    world.step((np.concatenate([pick, way]) / SPEC.action.scale).astype(np.float32))
    laid = world.points

    assert laid[:2, :2].mean(axis=0) == pytest.approx(pick + way, abs=0.025)
    assert laid[0, 2] < 4 * RADIUS_M


def test_a_state_after_picks_is_restored_bit_for_bit(world: RopeWorld) -> None:
    world.reset(np.random.default_rng(1), recipe=(KNOT,))
    expert = expert_of(world)((KNOT,), np.random.default_rng(1))
    for _ in range(3):
        snapshot, chosen = world.snapshot(), expert.act()
        assert chosen is not None
        action = chosen.action
        world.step(action)
    with closing(TASKS[0].make()) as other:
        other.restore(snapshot)
        other.step(action)

        assert other.snapshot() == world.snapshot()


def test_episodes_begin_with_curves_in_reach_that_do_not_cross() -> None:
    for seed in range(100):
        rng = np.random.default_rng(seed)
        from_left = initial_states.straight(rng, from_left=True)
        assert from_left[-1, 0] - from_left[0, 0] > 0.9 * LINKS * LINK_M
        for drawn in (initial_states.varied(rng), initial_states.straight(rng), from_left):
            assert np.abs(drawn).max() < REACH_M
            assert not len(crossings(np.column_stack([drawn, 0 * drawn[:, 0]])).over)


@pytest.mark.parametrize("actions", [30, pytest.param(2000, marks=pytest.mark.long)])
def test_exploration_leaves_the_rope_on_the_table_and_makes_no_knot(world: RopeWorld, actions: int) -> None:
    rng = np.random.default_rng(0)
    for action in range(actions):
        if action % SPEC.max_episode_steps == 0:
            world.reset(rng)
            explorer = RandomDisplacements(world, rng)
        assert not world.step(explorer.act().action).diverged
        points = world.points

        assert np.isfinite(points).all()
        assert np.abs(points[:, :2]).max() < 2 * VIEW_M
        assert points[:, 2].min() > 0
        assert points[:, 2].max() < 0.1
        assert not is_knotted(points)


@pytest.mark.parametrize(("skill", "most"), [(KNOT, 20), (S_SHAPE, 30)])
def test_the_expert_ties_a_knot_and_lays_an_s(world: RopeWorld, skill: str, most: int) -> None:
    shown = record_expert(world, (skill,), np.random.default_rng(1000))

    assert shown.success
    assert len(shown.actions) <= most


def test_a_recipe_of_two_skills_is_refused(world: RopeWorld) -> None:
    with pytest.raises(InvalidInput, match="one skill; got knot, s-shape"):
        world.reset(np.random.default_rng(0), recipe=(KNOT, S_SHAPE))


def test_tps_rpm_of_equal_and_of_moved_points_costs_nothing_in_any_order() -> None:
    turn = np.array([[np.cos(0.5), -np.sin(0.5)], [np.sin(0.5), np.cos(0.5)]])
    order = np.random.default_rng(0).permutation(len(S))

    assert register(S, S).cost_m == pytest.approx(0, abs=1e-9)
    assert register(S, S @ turn + [0.1, -0.2]).cost_m == pytest.approx(0, abs=1e-5)
    assert register(S, S[order]).matches.argmax(axis=1)[order].tolist() == list(range(len(S)))


def test_tps_rpm_recovers_a_known_warp() -> None:
    distances = np.linalg.norm(S[:, None] - S[[3, 22]], axis=-1)
    warped = S + 0.3 * (distances**2 * np.log(distances + 1e-12)) @ np.array([[1.0, 0.5], [-0.5, 1.0]])
    found = register(S, warped)

    assert np.abs(found.warped - warped).max() < 0.002
    assert found.matches.argmax(axis=1).tolist() == list(range(len(S)))


def test_tps_rpm_costs_more_for_larger_bends() -> None:
    line = turned(np.zeros(LINKS))
    costs = [register(line, turned(turn * np.linspace(-0.5, 0.5, LINKS))).cost_m for turn in (0, 0.5, 1, 2, 3)]

    assert costs == sorted(costs)
    assert costs[0] < 1e-6 < 0.005 < costs[1]
    assert register(S, line).cost_m > 0.03
