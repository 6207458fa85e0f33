from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from freerein.errors import InvalidInput
from freerein_sim.worlds import conformance, grid
from freerein_sim.worlds.conditions import Condition
from freerein_sim.worlds.conformance import determinism, experts, first_frames, interface, recipes
from freerein_sim.worlds.recipes import RandomOrder
from freerein_sim.worlds.replay import ReplayedWorld
from freerein_sim.worlds.tasks import tasks
from freerein_sim.worlds.world import LabelledAction, TaskDefinition, WorldSpec, skill_indices

REPLAYED = replace(grid.TASKS[0], name="replayed", make=lambda: ReplayedWorld(grid.GridWorld(indicator=True)))
OURS = tuple(tasks().values())


CHECKED_OF_ALL = ("blur", "light-0.6", "camera-5cm", "camera-3deg")
"""What stands in other worlds for all conditions of `blocks`: they are shared code."""


class _FewConditions(TaskDefinition):
    """A task without the conditions that it shares with `blocks`, but for a few."""

    @property
    def conditions(self) -> tuple[Condition, ...]:
        shared = {each.name for each in tasks()["blocks"].conditions}.difference(CHECKED_OF_ALL)
        return tuple(each for each in super().conditions if each.name not in shared)


def _with_few_conditions(task: TaskDefinition) -> TaskDefinition:
    """Returns a task with fewer conditions, of which two at most say in which room an episode begins."""
    if task.name == "blocks":
        return task
    few = _FewConditions(**{each.name: getattr(task, each.name) for each in fields(task)})
    return replace(few, own_conditions=task.own_conditions[-2:]) if task.world == "doom" else few


TASKS = {task.name: _with_few_conditions(task) for task in (*OURS, REPLAYED)}

CHECKED = sorted({"replayed", "blocks.blue-on-top-of-red", *(task.world for task in OURS)})
VARIANTS = ("grid-no-indicator", "blocks.scatter", "push.scatter", "dial.uneven", "bins.uneven")
"""They differ from these in what is seen, in their starts, or in demonstrations, which the golden record holds."""
HIDES_ITS_RECIPE = (
    "grid-no-indicator",
    *(pytest.param(name, marks=pytest.mark.long) for name in ("blocks", "dial", "tabletop", "bins")),  # many pictures
)
SHOWS_ITS_RECIPE = ("grid", pytest.param("tabletop.only-own-objects", marks=pytest.mark.long))
"""The indicator has the colour of the first object, and the other shows only what a recipe uses."""


@pytest.mark.parametrize("task", [TASKS[name] for name in CHECKED], ids=CHECKED)
@pytest.mark.parametrize("check", conformance.CHECKS, ids=[check.__name__ for check in conformance.CHECKS])
def test_our_worlds_conform(
    check: Callable[[TaskDefinition], None], task: TaskDefinition, keep_open: Callable[..., None]
) -> None:
    keep_open(task)
    for condition in task.conditions:
        if condition.group == "light":
            keep_open(task, condition.name)
    check(task)


@pytest.mark.parametrize("task", VARIANTS)
@pytest.mark.parametrize("check", [interface.describes_itself, determinism.restores_bit_for_bit])
def test_variants_of_our_worlds_conform(check: Callable[[TaskDefinition], None], task: str) -> None:
    check(TASKS[task])


def test_a_check_names_what_a_world_does_wrong() -> None:
    mislabelled = TaskDefinition("wrong", "blocks", "", grid.SPEC, TASKS["blocks"].make)

    with pytest.raises(AssertionError, match=r"The world's spec is the task's\."):
        interface.describes_itself(mislabelled)


class Inexpert(grid.GridWorld):
    expert = None  # type: ignore[assignment]


@pytest.mark.parametrize(
    ("world", "change"),
    [(Inexpert, {}), (Inexpert, {"has_expert": True}), (grid.GridWorld, {"skills": (), "has_expert": False})],
)
def test_a_spec_that_says_otherwise_than_the_world_whether_there_is_an_expert_is_found(
    world: type[grid.GridWorld], change: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    spec = replace(grid.SPEC, **change)
    monkeypatch.setattr(world, "spec", spec)

    with pytest.raises(AssertionError, match="is of a world with an expert"):
        interface.describes_itself(TaskDefinition("wrong", "grid", "", spec, partial(world, indicator=True)))


def test_a_world_has_an_expert_where_it_has_skills() -> None:
    for task in OURS:
        left_out = {each.name: getattr(task.spec, each.name) for each in fields(task.spec) if each.name != "has_expert"}

        assert WorldSpec(**left_out) == task.spec
        assert task.describe().has_expert == bool(task.spec.skills)


@pytest.mark.parametrize("task", HIDES_ITS_RECIPE)
@pytest.mark.parametrize("check", conformance.TAG_CHECKS, ids=[check.__name__ for check in conformance.TAG_CHECKS])
def test_the_start_of_an_episode_does_not_tell_its_skills(check: Callable[[TaskDefinition], None], task: str) -> None:
    check(TASKS[task])


@pytest.mark.parametrize("task", SHOWS_ITS_RECIPE)
def test_a_start_that_tells_the_skills_is_found(task: str) -> None:
    with pytest.raises(AssertionError, match="first frame"):
        first_frames.hides_its_recipe_at_the_start(TASKS[task])


class Forgetful(grid.GridExpert):
    """Says that it has picked up what it has not."""

    def act(self) -> LabelledAction | None:
        picks = super().act()
        return None if picks is None or picks.action[0] == grid.PICK_UP else picks

    def succeeded(self) -> bool:
        return True


class Boastful(grid.GridWorld):
    def expert(self, skills: Sequence[str], rng: np.random.Generator) -> Forgetful:
        return Forgetful(self, skill_indices(self.spec, skills), rng)


def test_an_expert_that_only_says_it_has_completed_its_skills_is_found() -> None:
    task = replace(TASKS["grid"], make=lambda: Boastful(indicator=True))

    with pytest.raises(AssertionError, match="completed at the end of its attempt"):
        experts.has_an_expert_that_succeeds(task)


def test_recipes_that_the_world_refuses_are_found() -> None:
    with pytest.raises(InvalidInput, match="reach and then one other skill"):
        recipes.draws_recipes_that_it_accepts(replace(TASKS["tabletop"], recipes=RandomOrder(most=2)))
