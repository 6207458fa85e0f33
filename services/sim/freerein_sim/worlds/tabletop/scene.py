"""The MuJoCo model of table, hand and things, of primitives only.

The hand flies: slide joints x, y and z, then hinges for its pitch and its roll about its own axis, each with a position
servo. It comes from the far side of the table, as a person does who sits opposite. It collides with nothing: welds,
active only while it holds a thing, attach things to it. x points to the camera, y to its right, z up, in metres.
"""

from functools import lru_cache

import mujoco
import numpy as np

from freerein_sim.worlds.mujoco_world import Scene, compile_scene
from freerein_sim.worlds.scenes import add_camera, add_lamp, add_servo, new_scene
from freerein_sim.worlds.tabletop.things import (
    BALL_RADIUS_M,
    BASE_HALF_M,
    BLOCK_HALF_M,
    BOWL_HEIGHT_M,
    BOWL_RADIUS_M,
    BOX_HALF_M,
    BOX_HEIGHT_M,
    CUP_HALF_M,
    CUP_RADIUS_M,
    POT_HEIGHT_M,
    POT_RADIUS_M,
    SPONGE_HALF_M,
    SPOON_TIP_M,
    SPOT_RADIUS_M,
    SPOTS,
    THINGS,
)

TIMESTEP_S = 0.004
HAND_JOINTS = ("x", "y", "z", "pitch", "roll")
HAND_LOW = np.array([-0.45, -0.6, 0.006, 0.2, -2.6])
HAND_HIGH = np.array([0.35, 0.6, 0.5, 1.5, 2.6])
"""Limits of the hand: position of the point between the fingertips in metres, pitch and roll in radians."""

OPENING_M = (0.006, 0.11)
"""Limits of the distance between the fingers."""

PAD_M = np.array([-3.0, 0.0, 0.0])
"""Where things lie that are not on show; its top is level with the table's."""

CAMERA = "front"
_CAMERA_AT_M, _CAMERA_TARGET_M, _CAMERA_FOVY_DEG = (1.0, 0.0, 0.82), (-0.06, 0.0, 0.05), 20.5
_TABLE_HALF_M, _PAD_HALF_M = (0.34, 0.85, 0.02), (0.5, 1.0, 0.02)
_MASS_KG = 0.08
_SLIDE_KP, _SLIDE_KV, _HINGE_KP, _HINGE_KV = 6000.0, 170.0, 60.0, 2.4
_HINGE_ARMATURE, _FINGER_KP, _FINGER_KV = 0.02, 200.0, 8.0

_BOX, _CYLINDER, _SPHERE = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_SPHERE
_ELLIPSOID, _CAPSULE = mujoco.mjtGeom.mjGEOM_ELLIPSOID, mujoco.mjtGeom.mjGEOM_CAPSULE
_NOT_SOLID = {"contype": 0, "conaffinity": 0}
_WELD = [*(0.0,) * 3, *(0.0,) * 3, *(1.0, 0, 0, 0), 1.0, 0.0]
"""Anchor, position and quaternion of the held body in the hand, torque scale."""

_WELD_SOLREF = [0.012, 1.0]
_SLICES, _STACKS = 16, 8
"""Of round geoms as they are drawn; MuJoCo's 28 and 16 take twice as long."""

_PAINT_M = 0.0008
"""Half thickness of what is painted on."""


def _gray(level: float) -> list[float]:
    return [level, level, level, 1.0]


@lru_cache(maxsize=1)
def build() -> Scene:
    """Returns the scene. Geoms are white, darker inside things; an episode multiplies them by its gray levels."""
    spec = new_scene(timestep_s=TIMESTEP_S, ambient=0.4, diffuse=0.25, znear=0.05, zfar=20)
    spec.visual.quality.numslices, spec.visual.quality.numstacks = _SLICES, _STACKS
    _add_room(spec.worldbody)
    _add_hand(spec)
    for name, add in _THINGS.items():
        body = spec.worldbody.add_body(name=name)
        body.add_freejoint(name=name)
        add(body)
    for name, add in _FIXTURES.items():
        add(spec.worldbody.add_body(name=name, mocap=True))
    for name in SPOTS:
        spot = spec.worldbody.add_body(name=name, mocap=True)
        spot.add_geom(type=_CYLINDER, size=[SPOT_RADIUS_M, _PAINT_M, 0], rgba=_gray(1), **_NOT_SOLID)
    for thing in THINGS:
        weld = spec.add_equality(type=mujoco.mjtEq.mjEQ_WELD, objtype=mujoco.mjtObj.mjOBJ_BODY, name=thing.name)
        weld.name1, weld.name2, weld.active, weld.solref = "hand", thing.name, False, _WELD_SOLREF
        weld.data = _WELD
    return compile_scene(spec)


def _add_room(world: mujoco.MjsBody) -> None:
    add_lamp(world, name="lamp", direction=(-0.55, 0.4, -0.8), diffuse=0.55)
    world.add_geom(name="table", type=_BOX, size=_TABLE_HALF_M, pos=[0, 0, -_TABLE_HALF_M[2]], rgba=_gray(1))
    world.add_geom(name="wall", type=_BOX, size=[0.02, 3, 2], pos=[-1.2, 0, 0], rgba=_gray(1), **_NOT_SOLID)
    world.add_geom(name="pad", type=_BOX, size=_PAD_HALF_M, pos=PAD_M - (0, 0, _PAD_HALF_M[2]), rgba=_gray(1))
    add_camera(world, CAMERA, at=_CAMERA_AT_M, to=_CAMERA_TARGET_M, fovy=_CAMERA_FOVY_DEG)


def _add_hand(spec: mujoco.MjSpec) -> None:
    hand = spec.worldbody.add_body(name="hand", gravcomp=1)
    slide, hinge = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
    for name, axis in (("x", (1, 0, 0)), ("y", (0, 1, 0)), ("z", (0, 0, 1))):
        hand.add_joint(name=name, type=slide, axis=axis)
    for name, axis in (("pitch", (0, 1, 0)), ("roll", (1, 0, 0))):
        hand.add_joint(name=name, type=hinge, axis=axis, armature=_HINGE_ARMATURE)
    hand.add_geom(name="palm", type=_BOX, size=[0.016, 0.058, 0.017], pos=[-0.075, 0, 0], mass=0.4, **_look(0.75))
    for name, ends, radius in (("wrist", (-0.08, -0.14), 0.024), ("arm", (-0.14, -0.6), 0.036)):
        hand.add_geom(
            name=name, type=_CAPSULE, fromto=[ends[0], 0, 0, ends[1], 0, 0], size=[radius, 0, 0], mass=0.3, **_look(1)
        )
    for side, sign in (("left", -1), ("right", 1)):
        finger = hand.add_body(name=f"finger.{side}", gravcomp=1)
        finger.add_joint(name=f"finger.{side}", type=slide, axis=[0, sign, 0], armature=0.05)
        finger.add_geom(type=_BOX, size=[0.037, 0.006, 0.011], pos=[-0.025, sign * 0.006, 0], mass=0.05, **_look(0.6))
        add_servo(spec, f"finger.{side}", kp=_FINGER_KP, kv=_FINGER_KV)
    for name in HAND_JOINTS:
        kp, kv = (_SLIDE_KP, _SLIDE_KV) if name in "xyz" else (_HINGE_KP, _HINGE_KV)
        add_servo(spec, name, kp=kp, kv=kv)


def _look(shade: float) -> dict[str, object]:
    return {"rgba": _gray(shade), **_NOT_SOLID}


def _add_cup(body: mujoco.MjsBody) -> None:
    body.add_geom(type=_CYLINDER, size=[CUP_RADIUS_M, CUP_HALF_M, 0], mass=_MASS_KG, rgba=_gray(1))
    _add_inside(body, CUP_RADIUS_M - 0.006, CUP_HALF_M)


def _add_spoon(body: mujoco.MjsBody) -> None:
    body.add_geom(type=_BOX, size=[0.065, 0.007, 0.006], pos=[0.03, 0, 0], mass=_MASS_KG, rgba=_gray(1))
    body.add_geom(type=_ELLIPSOID, size=[0.027, 0.019, 0.007], pos=[SPOON_TIP_M, 0, 0], mass=0.01, rgba=_gray(1))


def _add_block(body: mujoco.MjsBody) -> None:
    body.add_geom(type=_BOX, size=[BLOCK_HALF_M] * 3, mass=_MASS_KG, rgba=_gray(1))


def _add_base(body: mujoco.MjsBody) -> None:
    body.add_geom(type=_BOX, size=[BASE_HALF_M] * 3, mass=4 * _MASS_KG, rgba=_gray(1))


def _add_ball(body: mujoco.MjsBody) -> None:
    body.add_geom(
        type=_SPHERE, size=[BALL_RADIUS_M, 0, 0], mass=_MASS_KG, rgba=_gray(1), condim=6, friction=[1, 0.05, 0.01]
    )


def _add_sponge(body: mujoco.MjsBody) -> None:
    body.add_geom(type=_BOX, size=SPONGE_HALF_M, mass=_MASS_KG / 4, rgba=_gray(1))


def _add_bowl(body: mujoco.MjsBody) -> None:
    half = BOWL_HEIGHT_M / 2
    for radius, middle in ((0.6 * BOWL_RADIUS_M, half / 2), (BOWL_RADIUS_M, 1.5 * half)):
        size = [radius, half / 2, 0]
        body.add_geom(type=_CYLINDER, size=size, pos=[0, 0, middle], rgba=_gray(1), **_NOT_SOLID)
    _add_inside(body, BOWL_RADIUS_M - 0.007, BOWL_HEIGHT_M)


def _add_pot(body: mujoco.MjsBody) -> None:
    half = POT_HEIGHT_M / 2
    body.add_geom(type=_CYLINDER, size=[POT_RADIUS_M, half, 0], pos=[0, 0, half], rgba=_gray(1), **_NOT_SOLID)
    for side in (-1, 1):
        at = [0, side * (POT_RADIUS_M + 0.01), 1.6 * half]
        body.add_geom(type=_BOX, size=[0.014, 0.013, 0.005], pos=at, rgba=_gray(0.7), **_NOT_SOLID)
    _add_inside(body, POT_RADIUS_M - 0.006, POT_HEIGHT_M)


def _add_box(body: mujoco.MjsBody) -> None:
    outer, half, thin = BOX_HALF_M, BOX_HEIGHT_M / 2, 0.004
    body.add_geom(type=_BOX, size=[outer, outer, thin], pos=[0, 0, thin], rgba=_gray(0.5))
    for axis in (0, 1):
        for side in (-1, 1):
            at, size = [0.0, 0.0, half], [outer, outer, half]
            at[axis], size[axis] = side * outer, thin
            body.add_geom(type=_BOX, size=size, pos=at, rgba=_gray(1))


def _add_inside(body: mujoco.MjsBody, radius: float, top: float) -> None:
    body.add_geom(type=_CYLINDER, size=[radius, _PAINT_M, 0], pos=[0, 0, top], rgba=_gray(0.4), **_NOT_SOLID)


_THINGS = {
    "cup": _add_cup,
    "spoon": _add_spoon,
    "block": _add_block,
    "ball": _add_ball,
    "sponge": _add_sponge,
    "base": _add_base,
}
_FIXTURES = {"bowl": _add_bowl, "pot": _add_pot, "box": _add_box}
