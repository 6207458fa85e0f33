"""Draws demonstrations: who acts, which skills, in which order. Each is made from the seed and its index alone."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from freerein.errors import FailedPrecondition, InvalidInput
from freerein.types.common import Trajectory
from freerein.types.sim import DemonstrateRequest, DemonstrateResponse
from freerein_sim.workers import snapshots
from freerein_sim.worlds.demonstrate import Demonstration, demonstrate
from freerein_sim.worlds.wander import Wander
from freerein_sim.worlds.world import World, WorldSpec, check_view, skill_indices

_MAX_TRIES = 10


def draw(world: World, request: DemonstrateRequest) -> DemonstrateResponse:
    """Returns trajectory `first` of a request.

    An expert that fails tries again, with what its generator draws next.

    Args:
        world: A world of the request's task; in any state.
        request: What to demonstrate.

    Raises:
        InvalidInput: The request names what the world does not have, or bounds that cannot be met.
        FailedPrecondition: The expert failed too often.
    """
    views = _views(world.spec, request)
    rng = snapshots.generator(np.random.SeedSequence(request.seed, spawn_key=(request.first,)))
    for _ in range(_MAX_TRIES):
        made = _act(world, request, views, rng)
        if made.success:
            return _response(world.spec, made, request)
    raise FailedPrecondition(
        f"The expert must succeed within {_MAX_TRIES} tries; in trajectory {request.first} it did not.",
        hint=f"Go on with `first` = {request.first + 1}, or with another seed.",
    )


class _Views(dict[str, int]): ...
