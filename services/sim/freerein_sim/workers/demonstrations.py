"""Demonstrations and recipes: draws skills and their order. Each depends on the seed and its index only."""

from collections.abc import Sequence

import numpy as np

from freerein.errors import FailedPrecondition, InvalidInput, must_be
from freerein.types.common import Camera, Trajectory
from freerein.types.sim import DemonstrateRequest, DemonstrateResponse, DrawRecipesRequest, DrawRecipesResponse, Recipe
from freerein_sim.worlds.episodes import RecordedEpisode, record_episode, record_expert
from freerein_sim.worlds.generators import generator
from freerein_sim.worlds.random_policy import explorer_of
from freerein_sim.worlds.recipes import recipe_lengths
from freerein_sim.worlds.world import TaskDefinition, World, WorldSpec, no_expert, sized_cameras, skill_indices

_MAX_TRIES = 10


def make_demonstration(task: TaskDefinition, world: World, request: DemonstrateRequest) -> DemonstrateResponse:
    """Returns trajectory `first` of a request, made in a world of the task.

    It is drawn from `SeedSequence(seed).spawn(count)[first]`. An expert that fails retries from another initial state.
    A trajectory of random actions ends where the episode does, by a crash or after the task's number of steps, or where
    the explorer begins a manoeuvre.
    """
    views = _views(world.spec, request)
    skills, (fewest, most) = _skills(task, world.spec, request)
    rng = _generator(request.seed, request.first)
    for _ in range(_MAX_TRIES):
        recipe = task.recipes.draw(rng, skills, fewest=fewest, most=most) if request.behaviour == "expert" else None
        made = _act(task, world, recipe, views, rng, settle=request.settle)
        if made.success:
            return _response(world.spec, request, made)
    raise FailedPrecondition(
        f"The expert must succeed within {_MAX_TRIES} tries; for trajectory {request.first} it did not.",
        hint=f"Ask for all with another `seed`; in a call of the API, `first` {request.first + 1} skips this one.",
    )


def draw_recipes(task: TaskDefinition, spec: WorldSpec, request: DrawRecipesRequest) -> DrawRecipesResponse:
    """Returns recipes of a task; `spec` is that of its world under the request's conditions.

    Recipe i is that of demonstration i, if its expert succeeds at once.
    """
    skills, (fewest, most) = _choice(task, spec, request)
    rngs = (_generator(request.seed, index) for index in range(request.count))
    return DrawRecipesResponse(tuple(Recipe(task.recipes.draw(rng, skills, fewest=fewest, most=most)) for rng in rngs))


def _generator(seed: int, index: int) -> np.random.Generator:
    """Returns the generator of `SeedSequence(seed).spawn(count)[index]`."""
    return generator(np.random.SeedSequence(seed, spawn_key=(index,)))


def _act(
    task: TaskDefinition,
    world: World,
    recipe: Sequence[str] | None,
    views: Sequence[Camera],
    rng: np.random.Generator,
    *,
    settle: int,
) -> RecordedEpisode:
    """Records the expert at a recipe, or the task's explorer where there is none."""
    if recipe is not None:
        return record_expert(world, recipe, rng, cameras=views, settle=settle)
    world.reset(rng)
    explorer = explorer_of(task, world, rng)
    return record_episode(world, explorer, cameras=views, max_steps=world.spec.max_episode_steps)


def _response(spec: WorldSpec, request: DemonstrateRequest, made: RecordedEpisode) -> DemonstrateResponse:
    executed = made.labels[made.labels >= 0]
    skills = tuple(sorted(spec.skills[i] for i in set(executed.tolist())))
    trajectory = Trajectory(made.frames, made.actions, skills, terminated=made.terminated)
    if request.privileged and len(executed) == len(made.labels):
        return DemonstrateResponse(request.first, trajectory, made.labels)
    return DemonstrateResponse(request.first, trajectory)


def _skills(
    task: TaskDefinition, spec: WorldSpec, request: DemonstrateRequest
) -> tuple[tuple[str, ...], tuple[int, int]]:
    """Returns what the expert chooses from, as `_choice`; nothing for random actions."""
    if request.behaviour == "random":
        if request.skills or request.min_skills or request.max_skills:
            hint = "Random actions execute no skills: leave them out, or ask for the expert."
            names = "`skills`, `min_skills` and `max_skills`"
            raise must_be(names, "empty when behaviour is random", "some", field="skills", hint=hint)
        return (), (0, 0)
    return _choice(task, spec, request)


def _choice(
    task: TaskDefinition, spec: WorldSpec, request: DemonstrateRequest | DrawRecipesRequest
) -> tuple[tuple[str, ...], tuple[int, int]]:
    """Returns the skills to choose from, and the fewest and the most of a recipe."""
    if not spec.has_expert:
        raise no_expert()
    skills = request.skills or spec.skills
    if len(set(skill_indices(spec, skills))) != len(skills):
        raise InvalidInput("`skills` must name each skill once; got one twice.", field="skills")
    lengths = recipe_lengths(
        task.recipes, skills, fewest=request.min_skills, most=request.max_skills, limit=spec.max_skills
    )
    return skills, lengths


def _views(spec: WorldSpec, request: DemonstrateRequest) -> tuple[Camera, ...]:
    """Returns the cameras to record, with the one size at which they are recorded."""
    views = sized_cameras(spec, request.cameras or (spec.cameras[0].name,), height=request.height, width=request.width)
    if len({(view.height, view.width) for view in views}) > 1:
        hint = "All cameras of a trajectory are recorded at one size."
        rule = "given where cameras differ in size"
        raise must_be("`height` and `width`", rule, "none", field="height", hint=hint)
    return views
