"""Conformance tests for any `World`, including those of other packages.

    @pytest.mark.parametrize("check", conformance.CHECKS, ids=lambda check: check.__name__)
    def test_my_world_conforms(check):
        check(my_task)

A check raises `AssertionError` with a sentence; it makes and closes its own worlds. `CHECKS` are for every task,
`TAG_CHECKS` for those whose demonstrations are segmented by tags alone; these need `freerein[data]`.
"""

from collections.abc import Callable

from freerein_sim.worlds.conformance import conditions, determinism, experts, first_frames, interface, recipes
from freerein_sim.worlds.world import TaskDefinition

Check = Callable[[TaskDefinition], None]

CHECKS: tuple[Check, ...] = (
    interface.describes_itself,
    interface.tells_the_truth_in_shape,
    interface.starts_unsolved,
    determinism.repeats_itself_under_a_seed,
    determinism.resets_to_the_same_start,
    determinism.restores_bit_for_bit,
    determinism.refuses_broken_snapshots,
    determinism.demonstrates_the_same_under_a_seed,
    interface.renders_what_was_asked,
    interface.refuses_bad_views,
    interface.refuses_bad_actions,
    interface.refuses_unknown_skills,
    interface.judges_its_states,
    recipes.draws_recipes_that_it_accepts,
    experts.has_an_expert_that_succeeds,
    experts.has_an_expert_that_survives_any_state,
    experts.has_an_expert_of_its_own_recipe,
    conditions.declares_its_conditions,
    conditions.runs_under_each_condition,
    conditions.looks_different_under_conditions_of_the_camera,
)
"""Checks for every task, simplest first."""

TAG_CHECKS: tuple[Check, ...] = (first_frames.hides_its_recipe_at_the_start,)
"""Checks for a task whose skills are to be learned from the set of skills of each demonstration."""
