"""The MuJoCo model of table, hand and things; the hand comes from robosuite's wheel.

It is the gripper of the world `bins`, drawn as its collision geometry, as there: with its visual meshes a frame takes
five times as long. Its fingers stay closed. Instead of an arm there are three slide joints. The servos of x and y take
velocities, and their set-points move on with these. x points to the front camera, y to its right, z up, in metres; the
table top is z = 0.
"""

from collections.abc import Sequence
from functools import lru_cache

import mujoco
import numpy as np

from freerein_sim.worlds.colours import RGBA
from freerein_sim.worlds.mujoco_world import Scene, asset_folder, compile_scene
from freerein_sim.worlds.push.things import (
    OBJECT_M,
    PUCK_HEIGHT_M,
    TRAY_HEIGHT_M,
    TRAY_M,
    TRAY_WALL_M,
    Thing,
)
from freerein_sim.worlds.scenes import add_camera, add_lamp, add_servo, new_scene, use_firm_contacts

TIMESTEP_S = 0.005
TABLE_HALF_M = np.array([0.23, 0.25])
"""Half extents of the table along x and y."""

HAND_M = np.array([0.20, 0.21])
"""Greatest distance of the hand from the middle of the table, along x and y."""

HAND_JOINTS = ("hand.x", "hand.y", "hand.z")
LOW_M = 0.006
"""Height of the fingertips that push."""

CAMERAS = {
    "front": (1.285, 0.0, 1.015),
    "left": (0.0, -1.285, 1.015),
    "right": (0.0, 1.285, 1.015),
}
"""Positions. The cameras look down at 37 degrees: low enough to tell heights, and over most of what is in front."""

_TARGET_M, _FOVY_DEG = (0.0, 0.0, 0.045), 15.0
_TABLE, _FLOOR = (0.27, 0.28, 0.31, 1), (0.52, 0.56, 0.60, 1)
_STEEL, _RUBBER = (0.68, 0.69, 0.71, 1), (0.50, 0.51, 0.53, 1)
_FLOOR_OF_TRAY, _WALLS_OF_TRAY = (0.10, 0.78, 0.82, 1), (0.06, 0.47, 0.49, 1)
"""Cyan, a colour that no other thing has."""

_FINGERTIP_M = 0.123
"""Distance of the fingertips from the base of the gripper."""

_CLOSED_M = -0.0115
_SERVO_KP, _SERVO_KV, _SERVO_N = 4000.0, 140.0, 120.0
_KG = 0.1
_GEOM = mujoco.mjtGeom


@lru_cache(maxsize=16)
def build(things: tuple[Thing, ...], *, light: float = 1.0) -> Scene:
    """Returns the scene with these things. Cached, since compiling takes time.

    Args:
        things: All things that are ever on show.
        light: Factor of all lights.

    Raises:
        FailedPrecondition: robosuite's wheel is not installed.
    """
    spec = new_scene(timestep_s=TIMESTEP_S, ambient=0.38, diffuse=0.38, znear=0.05, zfar=10)
    spec.visual.quality.numslices = 24
    use_firm_contacts(spec)
    _add_room(spec.worldbody)
    for name, at in CAMERAS.items():
        add_camera(spec.worldbody, name, at=at, to=_TARGET_M, fovy=_FOVY_DEG)
    _add_hand(spec)
    for thing in things:
        _add_thing(spec.worldbody, thing)
    return compile_scene(spec, light=light)


def _add_room(world: mujoco.MjsBody) -> None:
    add_lamp(world, direction=(-0.5, 0.35, -0.8), diffuse=0.5)
    top = [*TABLE_HALF_M, 0.1]
    world.add_geom(name="table", type=_GEOM.mjGEOM_PLANE, size=top, rgba=_TABLE, friction=[0.3, 0.005, 0.0001])
    half_z = 0.02
    edge = {"size": [*TABLE_HALF_M, half_z], "pos": [0, 0, -half_z - 0.001], "rgba": _TABLE}
    world.add_geom(name="edge", type=_GEOM.mjGEOM_BOX, contype=0, conaffinity=0, **edge)
    floor = {"size": [4, 4, 0.01], "pos": [0, 0, -0.6], "rgba": _FLOOR}
    world.add_geom(name="floor", type=_GEOM.mjGEOM_BOX, contype=0, conaffinity=0, **floor)


def _add_hand(spec: mujoco.MjSpec) -> None:
    hand = spec.worldbody.add_body(name="hand")
    for name, axis in zip(HAND_JOINTS, np.eye(3), strict=True):
        hand.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
    downwards = hand.add_frame(pos=[0, 0, _FINGERTIP_M], quat=[0, 1, 0, 0])
    downwards.attach_body(_read_gripper().body("gripper_base"), "hand.", "")
    for body in hand.find_all(mujoco.mjtObj.mjOBJ_BODY):
        body.gravcomp = 1
    x, y, z = HAND_JOINTS
    for name, limit in zip((x, y), HAND_M, strict=True):
        servo = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.set_to_intvelocity(kp=_SERVO_KP, kv=_SERVO_KV)
        servo.actlimited, servo.actrange = True, (-limit, limit)
        servo.forcelimited, servo.forcerange = True, (-_SERVO_N, _SERVO_N)
    add_servo(spec, z, kp=_SERVO_KP, kv=_SERVO_KV, force=_SERVO_N)


def _read_gripper() -> mujoco.MjSpec:
    """Returns robosuite's gripper, closed, without its visual meshes; it collides with everything but itself."""
    assets = asset_folder("robosuite", listed_in="assets-robots.txt") / "models" / "assets"
    gripper = mujoco.MjSpec.from_file(str(assets / "grippers" / "rethink_gripper.xml"))
    visual = [geom for geom in gripper.geoms if geom.type == _GEOM.mjGEOM_MESH]
    fingers = [gripper.joint(f"{side}_finger_joint") for side in "lr"]
    for part in (*visual, *fingers, *gripper.meshes, *gripper.actuators, *gripper.sensors, *gripper.sites):
        gripper.delete(part)
    for side, sign in (("l", 1), ("r", -1)):
        finger = gripper.body(f"{side}_finger")
        finger.pos = np.add(finger.pos, [0, sign * _CLOSED_M, 0])
    for geom in gripper.geoms:
        geom.contype, geom.conaffinity = 0, 1
        geom.rgba = _RUBBER if "finger" in geom.name else _STEEL
    return gripper


def _add_thing(world: mujoco.MjsBody, thing: Thing) -> None:
    body = world.add_body(name=thing.name)
    body.add_freejoint(name=thing.name)
    half = OBJECT_M / 2
    match thing.kind:
        case "puck":
            _add_part(body, _GEOM.mjGEOM_CYLINDER, [half, PUCK_HEIGHT_M / 2, 0], RGBA[thing.colour])
        case "block":
            _add_part(body, _GEOM.mjGEOM_BOX, [half] * 3, RGBA[thing.colour])
        case "tray":
            _add_tray(body)


def _add_tray(body: mujoco.MjsBody) -> None:
    half, half_z, thin = TRAY_M / 2, TRAY_HEIGHT_M / 2, TRAY_WALL_M / 2
    _add_part(body, _GEOM.mjGEOM_BOX, [half, half, thin], _FLOOR_OF_TRAY, at=[0, 0, thin - half_z])
    for axis, side in ((axis, side) for axis in (0, 1) for side in (-1, 1)):
        at, size = [0.0, 0.0, 0.0], [half, half, half_z]
        at[axis], size[axis] = side * (half - thin), thin
        _add_part(body, _GEOM.mjGEOM_BOX, size, _WALLS_OF_TRAY, at=at)


def _add_part(
    body: mujoco.MjsBody,
    kind: mujoco.mjtGeom,
    size: Sequence[float],
    rgba: Sequence[float],
    *,
    at: Sequence[float] = (0, 0, 0),
) -> None:
    body.add_geom(type=kind, size=size, pos=at, rgba=rgba, mass=_KG, condim=4, friction=[0.6, 0.01, 0.001])
