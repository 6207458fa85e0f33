"""Plans of the demonstrator: how the hand moves in each skill, from the true state at its beginning."""

from collections.abc import Callable

import mujoco
import numpy as np
import numpy.typing as npt

from freerein_sim.worlds.tabletop import things
from freerein_sim.worlds.tabletop.motions import Movement, Pose
from freerein_sim.worlds.tabletop.simulation import TabletopWorld

Point = npt.NDArray[np.float64]
"""float64 (3,) in metres."""

Plan = Callable[[TabletopWorld, np.random.Generator, int], Movement]
"""Returns the movement of a skill that is to take a number of steps."""

_ROOM_M, _SQUEEZE_M = 0.03, 0.002
"""How much wider than a thing the fingers open, and how much narrower they close."""

_BEFORE_M, _BACK_M = 0.07, 0.08
"""How far before a thing the hand gets ready to grasp it, and how far it withdraws."""

_TRAVEL_M = (0.14, 0.18)
"""Height at which the hand carries things."""

_AIM_M, _PITCH_RAD = 0.003, 0.1
_DETOUR_STEPS, _DETOUR_M = 40, 0.05
_ROLL_RAD = (2.05, 2.4)
_STIRRING_RAD = (1.25, 1.4)
_PERIOD_STEPS = (10, 18)
"""How many steps of the skill each turn of the spoon, and each stroke of the sponge, takes beyond the first two."""

_TURNS, _TURNS_LEAST_STEPS, _STROKES_LEAST_STEPS = 1.3, 6.0, 4.5


def plan_reach(world: TabletopWorld, thing: things.Thing, rng: np.random.Generator, steps: int) -> Movement:
    """Goes to a thing, possibly by a detour, and closes the fingers around it at the end."""
    movement = Movement(world.set_point, rng)
    movement.rest(0.2, least=0.1)
    if world.held is thing:
        return movement
    if world.held is not None:
        movement.go(_open(movement.here, movement.here[5] + _ROOM_M), least=2)
    width = world.width(thing)
    place = world.position(thing.name) + rng.uniform(-_AIM_M, _AIM_M, size=3)
    goal = np.array([*place, thing.pitch_rad + rng.uniform(-_PITCH_RAD, _PITCH_RAD), 0, width + _ROOM_M])
    ready = _withdrawn(goal, _BEFORE_M)
    if steps >= _DETOUR_STEPS and rng.random() < 1 / 2:
        through = movement.here + rng.uniform(0.3, 0.7) * (ready - movement.here)
        through[:3] += rng.uniform(-_DETOUR_M, _DETOUR_M, size=3)
        movement.go(through)
        movement.rest(0.15)
    movement.go(ready, least=3)
    movement.rest(0.1)
    movement.go(goal, least=2)
    movement.rest(0.05, least=0.5)
    movement.go(_open(goal, width - _SQUEEZE_M), least=1.5)
    return movement


def _pour(world: TabletopWorld, rng: np.random.Generator, steps: int) -> Movement:
    """Carries the cup to the bowl, tilts it over, and back."""
    pose, bowl = world.set_point, world.position("bowl")
    angle, radius = rng.uniform(0, 2 * np.pi), 0.4 * world.scale("bowl") * things.BOWL_RADIUS_M
    height = world.scale("bowl") * things.BOWL_HEIGHT_M + rng.uniform(0.03, 0.06)
    lip = np.add(bowl, (radius * np.cos(angle), radius * np.sin(angle), height))
    roll = rng.uniform(*_ROLL_RAD) * (1 if pose[1] > bowl[1] else -1)
    pouring = _brought(world, world.point("cup", (0, 0, things.CUP_HALF_M)), lip, pitch=pose[3], roll=roll)
    over, upright = pouring.copy(), pouring.copy()
    over[4], upright[4] = 0.2 * roll, 0
    movement = _lift(world, rng)
    movement.go(over, least=2)
    movement.rest(0.1)
    movement.go(pouring, least=2)
    movement.rest(0.4, least=1.5)
    movement.go(upright, least=1.5)
    movement.rest(0.1)
    return movement


def _stir(world: TabletopWorld, rng: np.random.Generator, steps: int) -> Movement:
    """Dips the spoon into the pot, circles, and lifts it out."""
    height = world.scale("pot") * things.POT_HEIGHT_M
    radius = rng.uniform(0.4, 0.6) * world.scale("pot") * things.POT_RADIUS_M
    middle = np.add(world.position("pot"), (0, 0, rng.uniform(0.3, 0.5) * height))
    tip = world.point("spoon", (things.SPOON_TIP_M, 0, 0))
    stirring = _brought(world, tip, middle, pitch=rng.uniform(*_STIRRING_RAD), roll=0.0)
    first, sense = rng.uniform(0, 2 * np.pi), rng.choice((-1.0, 1.0))
    turns = sense * (_TURNS + max(0.0, steps / rng.uniform(*_PERIOD_STEPS) - 2))

    def circle(share: npt.NDArray[np.float64]) -> Pose:
        poses, angle = np.tile(stirring, (len(share), 1)), first + 2 * np.pi * turns * share
        poses[:, 0] += radius * np.cos(angle)
        poses[:, 1] += radius * np.sin(angle)
        return poses

    begin = circle(np.zeros(1))[0]
    movement = _lift(world, rng)
    movement.go(_raised(begin, height), least=2)
    movement.rest(0.1)
    movement.go(begin, least=1)
    movement.follow(circle, weight=rng.uniform(0.5, 1.2), least=_TURNS_LEAST_STEPS)
    movement.go(_raised(movement.here, height), least=1.5)
    return movement


def _stack(world: TabletopWorld, rng: np.random.Generator, steps: int) -> Movement:
    """Puts the block onto the other one."""
    height = world.scale("base") * things.BASE_HALF_M + world.scale("block") * things.BLOCK_HALF_M + _AIM_M
    return _put(world, things.BLOCK, np.add(world.position("base"), (0, 0, height)), rng)


def _place(world: TabletopWorld, rng: np.random.Generator, steps: int) -> Movement:
    """Drops the ball into the box."""
    height = world.scale("box") * things.BOX_HEIGHT_M + rng.uniform(0.005, 0.02)
    return _put(world, things.BALL, np.add(world.position("box"), (0, 0, height)), rng)


def _wipe(world: TabletopWorld, rng: np.random.Generator, steps: int) -> Movement:
    """Rubs the sponge over the stain, to and fro, and lifts it."""
    height = world.scale("sponge") * things.SPONGE_HALF_M[2] + _AIM_M
    middle = np.add(world.position("stain"), (0, 0, height))
    rubbing = _brought(world, world.position("sponge"), middle, pitch=world.set_point[3], roll=world.set_point[4])
    way = rng.choice((-1.0, 1.0)) * (world.scale("stain") * things.SPOT_PITCH_M + rng.uniform(0, 0.01))
    strokes = 1 + max(0, round(steps / rng.uniform(*_PERIOD_STEPS) - 2))

    def rub(share: npt.NDArray[np.float64]) -> Pose:
        poses = np.tile(rubbing, (len(share), 1))
        poses[:, 1] += way * np.cos(np.pi * strokes * share)
        return poses

    begin = rub(np.zeros(1))[0]
    movement = _lift(world, rng)
    movement.go(_raised(begin, _BEFORE_M), least=2)
    movement.rest(0.1)
    movement.go(begin, least=1)
    movement.follow(rub, weight=rng.uniform(0.5, 1.2), least=_STROKES_LEAST_STEPS)
    movement.go(_raised(movement.here, _BACK_M), least=1.5)
    return movement


TASK_PLANS: dict[str, Plan] = {"pour": _pour, "stir": _stir, "stack": _stack, "place": _place, "wipe": _wipe}
"""By skill. Each begins with its thing in the hand."""


def _put(world: TabletopWorld, thing: things.Thing, place: Point, rng: np.random.Generator) -> Movement:
    """Carries a thing to a place, lets go of it, and withdraws."""
    pose, aim = world.set_point, (*rng.uniform(-2 * _AIM_M, 2 * _AIM_M, size=2), 0)
    down = _brought(world, world.position(thing.name), np.add(place, aim), pitch=pose[3], roll=pose[4])
    free = _open(down, world.width(thing) + _ROOM_M)
    movement = _lift(world, rng)
    movement.go(_raised(down, _BEFORE_M), least=2)
    movement.rest(0.1)
    movement.go(down, least=1.5)
    movement.rest(0.1, least=0.5)
    movement.go(free, least=1)
    movement.go(_withdrawn(free, _BACK_M), least=3)
    movement.rest(0.1)
    return movement


def _lift(world: TabletopWorld, rng: np.random.Generator) -> Movement:
    """Begins a movement by lifting what is in the hand."""
    movement = Movement(world.set_point, rng)
    lifted = world.set_point
    lifted[2] = max(lifted[2], rng.uniform(*_TRAVEL_M))
    movement.go(lifted, least=1)
    return movement


def _brought(world: TabletopWorld, point: Point, goal: Point, *, pitch: float, roll: float) -> Pose:
    """Returns the pose at pitch and roll that brings a point, which moves with the hand, to a goal."""
    pose = world.set_point
    at, turned = world.hand
    moved = _rotation(pitch, roll) @ turned.T @ (point - at)
    return np.array([*(goal - moved), pitch, roll, pose[5]])


def _rotation(pitch: float, roll: float) -> npt.NDArray[np.float64]:
    """Returns the hand's axes, as columns: float64 (3, 3)."""
    axes, parts = np.empty(9), np.empty((2, 4))
    mujoco.mju_axisAngle2Quat(parts[0], np.array([0.0, 1, 0]), pitch)
    mujoco.mju_axisAngle2Quat(parts[1], np.array([1.0, 0, 0]), roll)
    turn = np.empty(4)
    mujoco.mju_mulQuat(turn, parts[0], parts[1])
    mujoco.mju_quat2Mat(axes, turn)
    return axes.reshape(3, 3)


def _withdrawn(pose: Pose, way_m: float) -> Pose:
    """Returns the pose farther back along the hand's own axis."""
    return np.subtract(pose, (way_m * np.cos(pose[3]), 0, -way_m * np.sin(pose[3]), 0, 0, 0))


def _raised(pose: Pose, way_m: float) -> Pose:
    return np.add(pose, (0, 0, way_m, 0, 0, 0))


def _open(pose: Pose, opening_m: float) -> Pose:
    return np.append(pose[:5], opening_m)
