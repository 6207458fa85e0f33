"""The MuJoCo model of table, hand and things, of primitives only.

The hand flies: slide joints x, y and z, then hinges for its pitch and its roll about its own axis, each with a position
servo. It comes from the far side of the table, as a person does who sits opposite. It collides with nothing: welds,
active only while it holds a thing, attach things to it. x points to the camera, y to its right, z up, in metres.
"""

from collections.abc import Iterator, Sequence
from functools import lru_cache

import mujoco
import numpy as np

from freerein_sim.worlds.mujoco_world import Scene, compile_scene
from freerein_sim.worlds.scenes import add_camera, add_lamp, add_servo, new_scene
from freerein_sim.worlds.tabletop import things

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
"""Slices and stacks of round geoms as they are drawn; MuJoCo's 28 and 16 take twice as long."""

_PAINT_M = 0.0008
"""Half thickness of what is painted on."""


Geom = dict[str, object]


def _gray(level: float) -> list[float]:
    return [level, level, level, 1.0]


@lru_cache(maxsize=1)
def build() -> Scene:
    """Returns the scene. Geoms are white, darker inside things; an episode multiplies them by its gray levels."""
    spec = new_scene(timestep_s=TIMESTEP_S, ambient=0.4, diffuse=0.25, znear=0.05, zfar=20)
    spec.visual.quality.numslices, spec.visual.quality.numstacks = _SLICES, _STACKS
    _add_room(spec.worldbody)
    _add_hand(spec)
    for name, geoms in (_THINGS | _FIXTURES).items():
        body = spec.worldbody.add_body(name=name, mocap=name in _FIXTURES)
        if name in _THINGS:
            body.add_freejoint(name=name)
        for geom in geoms:
            body.add_geom(**geom)
    for name in things.SPOTS:
        spot = spec.worldbody.add_body(name=name, mocap=True)
        spot.add_geom(type=_CYLINDER, size=[things.SPOT_RADIUS_M, _PAINT_M, 0], rgba=_gray(1), **_NOT_SOLID)
    for thing in things.THINGS:
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


def _solid(
    kind: mujoco.mjtGeom, *size: float, at: Sequence[float] = (0, 0, 0), kg: float = _MASS_KG, **more: object
) -> Geom:
    return {"type": kind, "size": [*size, 0, 0][:3], "pos": at, "mass": kg, "rgba": _gray(1), **more}


def _drawn(kind: mujoco.mjtGeom, *size: float, at: Sequence[float], shade: float = 1.0) -> Geom:
    return {"type": kind, "size": [*size, 0][:3], "pos": at, **_look(shade)}


def _inside(radius: float, top: float) -> Geom:
    return _drawn(_CYLINDER, radius, _PAINT_M, at=(0, 0, top), shade=0.4)


def _box() -> Iterator[Geom]:
    outer, half, thin = things.BOX_HALF_M, things.BOX_HEIGHT_M / 2, 0.004
    yield {"type": _BOX, "size": [outer, outer, thin], "pos": [0, 0, thin], "rgba": _gray(0.5)}
    for axis in (0, 1):
        for side in (-1, 1):
            at, size = [0.0, 0.0, half], [outer, outer, half]
            at[axis], size[axis] = side * outer, thin
            yield {"type": _BOX, "size": size, "pos": at, "rgba": _gray(1)}


_BOWL_M, _POT_M = (things.BOWL_RADIUS_M, things.BOWL_HEIGHT_M), (things.POT_RADIUS_M, things.POT_HEIGHT_M)
_THINGS: dict[str, Sequence[Geom]] = {
    "cup": (
        _solid(_CYLINDER, things.CUP_RADIUS_M, things.CUP_HALF_M),
        _inside(things.CUP_RADIUS_M - 0.006, things.CUP_HALF_M),
    ),
    "spoon": (
        _solid(_BOX, 0.065, 0.007, 0.006, at=(0.03, 0, 0)),
        _solid(_ELLIPSOID, 0.027, 0.019, 0.007, at=(things.SPOON_TIP_M, 0, 0), kg=0.01),
    ),
    "block": (_solid(_BOX, *[things.BLOCK_HALF_M] * 3),),
    "ball": (_solid(_SPHERE, things.BALL_RADIUS_M, condim=6, friction=[1, 0.05, 0.01]),),
    "sponge": (_solid(_BOX, *things.SPONGE_HALF_M, kg=_MASS_KG / 4),),
    "base": (_solid(_BOX, *[things.BASE_HALF_M] * 3, kg=4 * _MASS_KG),),
}
_FIXTURES: dict[str, Sequence[Geom]] = {
    "bowl": (
        _drawn(_CYLINDER, 0.6 * _BOWL_M[0], _BOWL_M[1] / 4, at=(0, 0, _BOWL_M[1] / 4)),
        _drawn(_CYLINDER, _BOWL_M[0], _BOWL_M[1] / 4, at=(0, 0, 0.75 * _BOWL_M[1])),
        _inside(_BOWL_M[0] - 0.007, _BOWL_M[1]),
    ),
    "pot": (
        _drawn(_CYLINDER, _POT_M[0], _POT_M[1] / 2, at=(0, 0, _POT_M[1] / 2)),
        *(
            _drawn(_BOX, 0.014, 0.013, 0.005, at=(0, side * (_POT_M[0] + 0.01), 0.8 * _POT_M[1]), shade=0.7)
            for side in (-1, 1)
        ),
        _inside(_POT_M[0] - 0.006, _POT_M[1]),
    ),
    "box": tuple(_box()),
}
"""By name, the geoms of things that move, and of those that stay."""
