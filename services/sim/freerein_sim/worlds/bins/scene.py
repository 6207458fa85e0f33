"""The MuJoCo model of Sawyer, bins and groceries, from files of robosuite's wheel.

The robot is drawn as its collision geometry, since its visual meshes take four times as long. x points from the robot
to the camera, y to the camera's right, z up, in metres; the origin is robosuite's.
"""

from functools import lru_cache
from pathlib import Path

import mujoco

from freerein_sim.worlds.bins.layout import GROCERIES, Grocery
from freerein_sim.worlds.mujoco_world import Scene, asset_folder, compile_scene
from freerein_sim.worlds.scenes import add_servo, use_firm_contacts

TIMESTEP_S = 0.0025
ARM = tuple(f"sawyer.right_j{i}" for i in range(7))
FINGERS = {"sawyer.gripper.r_finger_joint": -1, "sawyer.gripper.l_finger_joint": 1}
"""Joints of the fingers, and the sign of opening."""

FINGER_M = (-0.0115, 0.020833)
"""Range of each finger's joint, in its direction of opening."""

FINGER_BASE_M = 0.01855
"""Distance of a finger's pad from the middle where its joint is at 0."""

GRIP = "sawyer.gripper.grip_site"
"""Site between the fingertips."""

_KP, _KV = (3000, 3000, 2000, 2000, 500, 500, 200), (150, 150, 100, 100, 20, 20, 8)
_TORQUES_NM = (80, 80, 40, 40, 9, 9, 9)
_KG = {"bread": 0.06, "can": 0.12, "cereal": 0.12, "milk": 0.12}
_BASE_M = (-0.5, -0.1, 0.912)
_PEDESTAL_M = (0.1, _BASE_M[2] / 2)
_CAMERA_M = (1.0, 0.015, 2.02)
_NOT_DRAWN = 3
_SLICES = 16
_RED, _DARK, _STEEL, _RUBBER = (
    (0.62, 0.06, 0.07, 1),
    (0.16, 0.16, 0.18, 1),
    (0.72, 0.72, 0.74, 1),
    (0.10, 0.10, 0.11, 1),
)
_COLOURS = {"finger": _RUBBER, "gripper": _STEEL, "base": _DARK, "link0": _DARK, "_2": _DARK}
"""Colours of the robot's geoms by a part of their name, the first that fits."""


@lru_cache(maxsize=8)
def build(*, light: float = 1.0) -> Scene:
    """Returns the scene. Cached, since compiling takes a third of a second.

    Args:
        light: Factor of all lights.

    Raises:
        FailedPrecondition: robosuite's wheel is not installed.
    """
    assets = asset_folder("robosuite", listed_in="assets-robots.txt") / "models" / "assets"
    spec = mujoco.MjSpec.from_file(str(assets / "arenas" / "bins_arena.xml"))
    spec.option.timestep = TIMESTEP_S
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    use_firm_contacts(spec)
    _set_view(spec)
    _add_robot(spec, assets)
    for grocery in GROCERIES:
        _add_grocery(spec, assets, grocery)
    return compile_scene(spec, light=light)


def _set_view(spec: mujoco.MjSpec) -> None:
    """Moves robosuite's camera back until it sees both bins; each wall of the bins is drawn once."""
    spec.camera("agentview").pos = _CAMERA_M
    spec.visual.map.znear, spec.visual.map.zfar = 0.02, 10
    spec.visual.quality.numslices = _SLICES
    for geom in (*spec.body("bin1").geoms, *spec.body("bin2").geoms):
        if geom.contype:
            geom.group = _NOT_DRAWN


def _add_robot(spec: mujoco.MjSpec, assets: Path) -> None:
    robot = mujoco.MjSpec.from_file(str(assets / "robots" / "sawyer" / "robot.xml"))
    gripper = mujoco.MjSpec.from_file(str(assets / "grippers" / "rethink_gripper.xml"))
    for part in (robot, gripper):
        for geom in part.geoms:
            _show_or_delete(part, geom)
        for mesh in part.meshes:
            part.delete(mesh)
        for site in part.sites:
            site.group = _NOT_DRAWN
        for body in part.bodies:
            body.gravcomp = 1
    for motor in robot.actuators:
        robot.delete(motor)
    for finger in gripper.actuators:
        finger.name = finger.target
        low, high = sorted(FINGERS[f"sawyer.gripper.{finger.target}"] * limit for limit in FINGER_M)
        finger.ctrlrange = (low, high)
    robot.body("right_hand").add_frame().attach_body(gripper.body("gripper_base"), "gripper.", "")
    spec.worldbody.add_frame(pos=_BASE_M).attach_body(robot.body("base"), "sawyer.", "")
    for joint, kp, kv, torque_nm in zip(ARM, _KP, _KV, _TORQUES_NM, strict=True):
        add_servo(spec, joint, kp=kp, kv=kv, force=torque_nm)
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=[*_PEDESTAL_M, 0],
        pos=[*_BASE_M[:2], _PEDESTAL_M[1]],
        rgba=_DARK,
        contype=0,
        conaffinity=0,
    )


def _show_or_delete(part: mujoco.MjSpec, geom: mujoco.MjsGeom) -> None:
    """Deletes visual meshes; collision geoms are coloured, and collide with everything but the robot."""
    if geom.type == mujoco.mjtGeom.mjGEOM_MESH:
        part.delete(geom)
        return
    geom.contype, geom.conaffinity = 0, 1
    geom.rgba = next((rgba for word, rgba in _COLOURS.items() if word in geom.name), _RED)
    if "head" in geom.name or "screen" in geom.name:
        geom.group = _NOT_DRAWN


def _add_grocery(spec: mujoco.MjSpec, assets: Path, grocery: Grocery) -> None:
    read = mujoco.MjSpec.from_file(str(assets / "objects" / f"{grocery.name}.xml"))
    body = spec.worldbody.add_frame().attach_body(read.body("object"), f"{grocery.name}.", "")
    body.add_freejoint(name=grocery.name)
    for geom in body.geoms:
        geom.mass = _KG[grocery.name]
