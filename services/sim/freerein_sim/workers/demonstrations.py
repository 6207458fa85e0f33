"""Demonstrations: draws skills and their order, and records the policy. Each depends on the seed and its index only."""

from collections.abc import Sequence

import numpy as np

from freerein.errors import FailedPrecondition, InvalidInput
from freerein.types.common import Camera, Trajectory
from freerein.types.sim import DemonstrateRequest, DemonstrateResponse
from freerein_sim.worlds.episodes import RecordedEpisode, record_episode
from freerein_sim.worlds.generators import generator
from freerein_sim.worlds.random_policy import SmoothRandomPolicy
from freerein_sim.worlds.world import World, WorldSpec, expert_of, no_expert, sized_cameras, skill_indices

_MAX_TRIES = 10


def make_demonstration(world: World, request: DemonstrateRequest) -> DemonstrateResponse:
    """Returns trajectory `first` of a request.

    It is drawn from `SeedSequence(seed).spawn(count)[first]`. An expert that fails retries from another initial state.
    """
    views = _views(world.spec, request)
    skills = _skills(world.spec, request)
    rng = generator(np.random.SeedSequence(request.seed, spawn_key=(request.first,)))
    for _ in range(_MAX_TRIES):
        made = _act(world, request, skills, views, rng)
        if made.success:
            return _response(world.spec, request, made)
    raise FailedPrecondition(
        f"The expert must succeed within {_MAX_TRIES} tries; for trajectory {request.first} it did not.",
        hint=f"Skip it: ask again with `first` {request.first + 1}.",
    )


def _act(
    world: World,
    request: DemonstrateRequest,
    skills: Sequence[str],
    views: Sequence[Camera],
    rng: np.random.Generator,
) -> RecordedEpisode:
    if request.behaviour == "expert":
        least, most = _number_of_skills(world.spec, request, skills)
        number = rng.integers(least, most, endpoint=True)
        chosen = [skills[i] for i in rng.permutation(len(skills))[:number]]
        world.reset(rng, recipe=chosen)
        policy = expert_of(world)(chosen, rng)
    else:
        world.reset(rng)
        policy = SmoothRandomPolicy(world.spec.action, rng)
    return record_episode(world, policy, cameras=views, max_steps=world.spec.max_episode_steps)


def _response(spec: WorldSpec, request: DemonstrateRequest, made: RecordedEpisode) -> DemonstrateResponse:
    executed = made.labels[made.labels >= 0]
    skills = tuple(sorted(spec.skills[i] for i in set(executed.tolist())))
    trajectory = Trajectory(made.frames, made.actions, skills, terminated=made.terminated)
    if request.privileged and len(executed) == len(made.labels):
        return DemonstrateResponse(request.first, trajectory, made.labels)
    return DemonstrateResponse(request.first, trajectory)


def _skills(spec: WorldSpec, request: DemonstrateRequest) -> tuple[str, ...]:
    """Returns the skills to choose from."""
    if request.behaviour == "random":
        if request.skills or request.min_skills or request.max_skills:
            raise InvalidInput(
                "`skills`, `min_skills` and `max_skills` must be empty when behaviour is random; got some.",
                field="skills",
                hint="Random actions execute no skills: leave them out, or ask for the expert.",
            )
        return ()
    if not spec.has_expert:
        raise no_expert()
    skills = request.skills or spec.skills
    if len(set(skill_indices(spec, skills))) != len(skills):
        raise InvalidInput("`skills` must name each skill once; got one twice.", field="skills")
    least, most = _number_of_skills(spec, request, skills)
    if not least <= most <= _most_skills(spec, skills):
        raise InvalidInput(
            f"1 <= `min_skills` <= `max_skills` <= {_most_skills(spec, skills)} must hold, the number of skills to "
            f"choose from, or of a recipe; got {request.min_skills} and {request.max_skills}.",
            field="max_skills",
            hint="Each skill occurs once at most. 0 means no bound.",
        )
    return skills


def _number_of_skills(spec: WorldSpec, request: DemonstrateRequest, skills: Sequence[str]) -> tuple[int, int]:
    """Returns the fewest and the most skills of a trajectory; 0 of an expert that has none."""
    return request.min_skills or min(1, len(skills)), request.max_skills or _most_skills(spec, skills)


def _most_skills(spec: WorldSpec, skills: Sequence[str]) -> int:
    return min(len(skills), spec.max_skills or len(skills))


def _views(spec: WorldSpec, request: DemonstrateRequest) -> tuple[Camera, ...]:
    """Returns the cameras to record, with the one size at which they are recorded."""
    views = sized_cameras(spec, request.cameras or (spec.cameras[0].name,), height=request.height, width=request.width)
    if len({(view.height, view.width) for view in views}) > 1:
        raise InvalidInput(
            "`height` and `width` must be given where cameras differ in size; got none.",
            field="height",
            hint="All cameras of a trajectory are recorded at one size.",
        )
    return views
