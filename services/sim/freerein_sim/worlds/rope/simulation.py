"""The rope world in MuJoCo: an action picks the rope up, carries it, lays it down, and lets it come to rest."""

from collections.abc import Collection, Sequence

import numpy as np
import numpy.typing as npt

from freerein_sim.worlds.camera_moves import camera_move
from freerein_sim.worlds.conditions import light_scale
from freerein_sim.worlds.mujoco_world import MakeWorldExpert, MujocoWorld
from freerein_sim.worlds.recipes import check_one
from freerein_sim.worlds.rope import initial_states, scene
from freerein_sim.worlds.rope.knots import Points
from freerein_sim.worlds.rope.spec import FROM_LEFT, LINK_M, LINKS, RADIUS_M, REACH_M, SPEC
from freerein_sim.worlds.world import Action, GroundTruth, StepResult, check_actions, skill_indices

CATCH_M = 0.025
"""Distance from a pick within which the middle of a link is caught, horizontally: half the diagonal of a cell of a grid
of 20 x 20 is 2.3 cm."""

LEAST_M = 0.005
"""Displacements that are shorter move nothing."""

_LIFT_M, _DROP_M = 0.04, 0.008
"""Heights of the hand while it carries the rope, and where it lets go."""

_LIFT_S, _CARRY_M_PER_S = 0.12, 0.6
_REST_M_PER_S, _REST_STEPS, _REST_PARTS = 0.01, 10, 12
"""The rope is at rest when no point is faster. That is looked at after each part of so many steps, at most so often."""

Place = npt.NDArray[np.float64]
"""float64 (2,) or (3,): x, y, and z in metres."""


class RopeWorld(MujocoWorld):
    """A rope on a table, seen from above. It has no goal.

    Args:
        make_expert: Makes its experts.
        conditions: Of light, cameras and starts.

    Attributes:
        recipe: That of the episode; empty for one without.
    """

    def __init__(self, make_expert: MakeWorldExpert, conditions: Collection[str] = ()) -> None:
        built = scene.build(light=light_scale(conditions))
        super().__init__(SPEC, built, make_expert, camera_move(conditions, cameras=len(SPEC.cameras)))
        self.recipe: tuple[str, ...] = ()
        self._starts_from_left = FROM_LEFT in conditions
        self._links = [built.model.body(scene.link_name(link)).id for link in range(LINKS)]
        self._ties = [built.model.equality(scene.link_name(link)).id for link in range(LINKS)]

    def reset(self, rng: np.random.Generator, *, recipe: Sequence[str] = ()) -> None:
        """Lays the rope down in a varied curve; nearly straight where a recipe follows.

        Raises:
            InvalidInput: The recipe is not one skill.
        """
        skill_indices(SPEC, recipe)
        check_one(recipe, begin="with the rope in any curve")
        from_left = self._starts_from_left
        curve = initial_states.straight(rng, from_left=from_left) if recipe else initial_states.varied(rng)
        self.recipe = tuple(recipe)
        self._simulation.reset(rng)
        self._lay(curve)
        self._rest()

    def step(self, action: Action) -> StepResult:
        """Picks the rope up and lays it down again; a pick that misses it moves nothing."""
        check_actions(SPEC.action, action)
        x, y, dx, dy = np.multiply(action, SPEC.action.scale, dtype=np.float64)
        link = self.caught(np.array([x, y]))
        if link is None or np.hypot(dx, dy) < LEAST_M:
            return StepResult(terminated=False)
        place = np.clip([x + dx, y + dy], -REACH_M, REACH_M)
        diverged = self._carry(link, place) or self._rest()
        return StepResult(terminated=diverged, diverged=diverged)

    def truth(self) -> GroundTruth:
        """Returns the points of the rope; there is no goal to reach."""
        return GroundTruth(self.points.ravel(), 0.0, success=False)

    @property
    def points(self) -> Points:
        """Ends of the links in order along the rope: float64 (26, 3), in metres."""
        begins = self._data.xpos[self._links]
        along = self._data.xmat[self._links[-1]].reshape(3, 3)[:, 0]
        return np.concatenate([begins, begins[-1:] + LINK_M * along])

    def caught(self, pick: Place) -> int | None:
        """Returns the link that a pick at x, y catches, None where it misses. Of two strands it is the upper one."""
        points = self.points
        middles = (points[1:] + points[:-1]) / 2
        apart = np.linalg.norm(middles[:, :2] - pick, axis=1)
        if apart.min() > CATCH_M:
            return None
        return int(np.argmin(np.where(apart <= CATCH_M, apart - middles[:, 2], np.inf)))

    def _lay(self, curve: initial_states.Curve) -> None:
        """Sets the rope to a curve on the table."""
        steps = np.diff(curve, axis=0)
        headings = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
        half = headings[0] / 2
        self._data.joint("rope").qpos = (*curve[0], RADIUS_M, np.cos(half), 0, 0, np.sin(half))
        for link in range(1, LINKS):
            self._data.joint(scene.bend_name(link)).qpos = headings[link] - headings[link - 1]
        self._simulation.refresh()

    def _carry(self, link: int, place: Place) -> bool:
        """Ties a link to the hand, lifts it, brings it to x, y, and lets go; returns whether that diverged."""
        points = self.points
        at = (points[link] + points[link + 1]) / 2
        above = at + np.array([0, 0, _LIFT_M])
        there = np.array([*place, above[2]])
        carry_s = float(np.linalg.norm(there - above)) / _CARRY_M_PER_S
        ways = ((at, above, _LIFT_S), (above, there, carry_s), (there, np.array([*place, _DROP_M]), _LIFT_S))
        self._data.eq_active[self._ties[link]] = True
        diverged = any(self._move_hand(begin, end, seconds) for begin, end, seconds in ways)
        self._data.eq_active[self._ties[link]] = False
        return diverged

    def _move_hand(self, begin: Place, end: Place, seconds: float) -> bool:
        """Moves the hand smoothly from one place to another; returns whether the simulation diverged."""
        steps = max(round(seconds / scene.TIMESTEP_S), 1)
        for part in np.arange(1, steps + 1) / steps:
            self._data.mocap_pos[0] = begin + (end - begin) * part**2 * (3 - 2 * part)
            if self._simulation.step(1):
                return True
        return False

    def _rest(self) -> bool:
        """Waits until the rope is at rest, for 0.6 s at most; returns whether the simulation diverged."""
        for _ in range(_REST_PARTS):
            before = self.points
            if self._simulation.step(_REST_STEPS):
                return True
            self._simulation.refresh()
            moved = np.linalg.norm(self.points - before, axis=1).max()
            if moved < _REST_M_PER_S * _REST_STEPS * scene.TIMESTEP_S:
                break
        return False
