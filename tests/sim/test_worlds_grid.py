import numpy as np
import pytest

from freerein.errors import InvalidInput
from freerein_sim.worlds.episodes import RecordedEpisode, record_expert
from freerein_sim.worlds.grid import CELL_PX, COLOURS, FIELD, PICK_UP, SPEC, GridWorld

UP, DOWN, LEFT, RIGHT = (np.array([choice]) for choice in range(4))
PICK = np.array([PICK_UP])


def place(world: GridWorld, *, agent: tuple[int, int], recipe: tuple[int, ...]) -> None:
    """Puts the agent somewhere and the object of colour i into row i, column 5."""
    objects = [coordinate for row in range(len(COLOURS)) for coordinate in (row, 5)]
    padded = recipe + (-1,) * (len(COLOURS) - len(recipe))
    world.restore(np.array([1, *agent, *objects, *padded, *[-1] * 5], np.int8).tobytes())


def cell(world: GridWorld, row: int, column: int) -> list[int]:
    red, green, blue = world.render("top", height=33, width=30)[row * CELL_PX, column * CELL_PX]
    return [int(red), int(green), int(blue)]


def show(seed: int, skills: tuple[str, ...]) -> RecordedEpisode:
    return record_expert(GridWorld(indicator=True), skills, np.random.default_rng(seed))


def test_moves_go_one_cell_and_stop_at_the_edge() -> None:
    world = GridWorld(indicator=True)
    place(world, agent=(0, 0), recipe=(0,))

    places = []
    for action in (UP, LEFT, DOWN, RIGHT):
        world.step(action)
        places.append(world.truth().state[:2].tolist())

    assert places == [[0, 0], [0, 0], [1, 0], [1, 1]]


def test_pick_up_takes_only_what_lies_under_the_agent() -> None:
    world = GridWorld(indicator=True)
    place(world, agent=(0, 4), recipe=(0, 1))

    world.step(PICK)
    nothing = world.truth().state[2:4].tolist()
    world.step(RIGHT)
    world.step(PICK)

    assert nothing == [0, 5]
    assert world.truth().state[2:4].tolist() == [-1, -1]


def test_the_indicator_shows_the_next_object_of_the_recipe_and_goes_dark_at_the_end() -> None:
    world = GridWorld(indicator=True)
    place(world, agent=(1, 4), recipe=(1, 0))
    red, green = (cell(world, row, 5) for row in range(2))

    shown, ended = [cell(world, FIELD, 0)], []
    for action in (RIGHT, PICK, UP, PICK):
        ended.append(world.step(action).terminated)
        shown.append(cell(world, FIELD, 0))

    assert shown == [green, green, red, red, [0, 0, 0]]
    assert ended == [False, False, False, True]
    assert world.truth().success


def test_the_wrong_order_ends_the_episode_without_success() -> None:
    world = GridWorld(indicator=True)
    place(world, agent=(1, 5), recipe=(0, 1))

    outcomes = [world.step(action).terminated for action in (PICK, UP, PICK)]

    assert outcomes == [False, False, True]
    assert not world.truth().success


def test_without_the_indicator_the_recipe_cannot_be_seen() -> None:
    images = []
    for recipe in ((0, 1), (3,)):
        world = GridWorld(indicator=False)
        place(world, agent=(9, 9), recipe=recipe)
        images.append(world.render("top", height=33, width=30))

    assert np.array_equal(images[0], images[1])


def test_every_object_lies_on_the_field_whatever_the_recipe() -> None:
    world = GridWorld(indicator=True)
    world.reset(np.random.default_rng(0), recipe=("pick-blue",))

    assert (world.truth().state >= 0).all()


def test_the_expert_walks_shortest_paths_and_labels_them_by_the_object_it_goes_for() -> None:
    skills = ("pick-yellow", "pick-red")
    world = GridWorld(indicator=True)
    world.reset(np.random.default_rng(3), recipe=skills)
    agent, objects = np.split(world.truth().state, [2])
    yellow, red = objects.reshape(-1, 2)[[COLOURS.index("yellow"), COLOURS.index("red")]]
    first, second = (int(np.abs(way).sum()) + 1 for way in (yellow - agent, red - yellow))

    shown = show(3, skills)

    assert shown.success
    assert shown.labels.tolist() == [SPEC.skills.index("pick-yellow")] * first + [0] * second


def test_the_expert_always_finishes_five_skills_in_fifty_steps() -> None:
    shown = [show(seed, tuple(np.random.default_rng(seed).permutation(SPEC.skills))) for seed in range(100)]

    assert all(each.success for each in shown)
    assert max(len(each.labels) for each in shown) <= SPEC.max_episode_steps


def test_a_recipe_names_each_skill_once() -> None:
    with pytest.raises(InvalidInput, match="each skill once"):
        GridWorld(indicator=True).reset(np.random.default_rng(0), recipe=("pick-red", "pick-red"))


@pytest.mark.parametrize(
    ("index", "value"),
    [(1, 10), (2, -2), (3, 10), (3, 1), (13, 5), (14, 0), (18, 0)],
    ids=[
        "agent off the field",
        "agent negative",
        "object off",
        "two objects in one cell",
        "no such colour",
        "twice",
        "picked but there",
    ],
)
def test_a_snapshot_of_an_impossible_state_is_refused(index: int, value: int) -> None:
    world = GridWorld(indicator=True)
    place(world, agent=(0, 0), recipe=(0,))
    tampered = np.frombuffer(world.snapshot(), np.int8).copy()
    tampered[index] = value

    with pytest.raises(InvalidInput, match="no state has"):
        world.restore(tampered.tobytes())
