"""The MuJoCo model of table, blocks and gripper; the gripper's meshes come from the gymnasium-robotics wheel.

Instead of an arm there are two slide joints, y and z, whose position servos follow a set-point as the arm follows its
mocap body in the Fetch environments. x points to the front camera, y to its right, z up, in metres.
"""

from functools import lru_cache

import mujoco

from freerein_sim.worlds.blocks.distractors import DISTRACTORS
from freerein_sim.worlds.blocks.relations import BLOCK_M
from freerein_sim.worlds.colours import RGBA
from freerein_sim.worlds.mujoco_world import Scene, asset_folder, compile_scene
from freerein_sim.worlds.scenes import add_camera, add_lamp, add_servo, new_scene, use_firm_contacts

TABLE_HALF_X_M, TABLE_HALF_Y_M = 0.14, 0.30
GRIPPER_Y_M = (-0.22, 0.22)
GRIPPER_Z_M = (0.043, 0.26)
FINGER_M = (0.0, 0.05)
"""Range of each finger's distance from the midpoint, as Fetch's."""

FINGER_BASE_M = 0.001
"""Distance of a closed finger's inner side from the midpoint."""

FINGER_HALF_M = (0.0385, 0.005, 0.0135)
"""Half extents of a finger along the gripper's axes: down, y and to the front."""

PAD_M = (-1.2, 0.0, -0.01)
"""Centre of the pad behind the back wall; its top is level with the table's."""

TIMESTEP_S = 0.002

_TABLE, _WALL, _FLOOR = (0.17, 0.18, 0.21, 1), (0.47, 0.53, 0.58, 1), (0.34, 0.36, 0.39, 1)
_STEEL, _RUBBER = (0.82, 0.83, 0.85, 1), (0.13, 0.13, 0.15, 1)
_LINKS_M = {"gripper_link": 0.0, "wrist_roll_link_collision": -0.1664, "wrist_flex_link_collision": -0.3049}
"""Meshes of gripper and wrist, and their offset along the gripper's x axis."""

_CACHED_SCENES = 16
_LINK_KG, _FINGER_KG, _BLOCK_KG = 0.3, 0.1, 0.1
_SERVO_KP, _SERVO_KV, _SERVO_N = 4000.0, 140.0, 120.0
_FINGER_KP, _FINGER_KV, _FINGER_ARMATURE_KG = 500.0, 20.0, 0.1
_PAD_HALF_M = (0.1, 0.3, 0.01)
CAMERAS = {
    "front": ((1.00, 0.0, 0.31), (0.0, 0.0, 0.12), 27.5),
    "left": ((0.0, -1.00, 0.31), (0.0, 0.0, 0.12), 27.5),
    "tilt": ((0.74, 0.0, 0.80), (0.0, 0.0, 0.06), 27.0),
}
"""By name: position, target, and vertical field of view in degrees."""


@lru_cache(maxsize=_CACHED_SCENES)
def build(colours: tuple[str, ...], *, pad: bool = False, light: float = 1.0, distractor: str = "") -> Scene:
    """Returns the scene with one block of each colour. Cached, since compiling takes a tenth of a second.

    Args:
        colours: Colours of the blocks.
        pad: Whether there is a pad for hidden blocks.
        light: Factor of all lights.
        distractor: Kind of the distractors; empty for none.
    """
    spec = new_scene(timestep_s=TIMESTEP_S, ambient=0.38, diffuse=0.38, znear=0.02, zfar=10)
    use_firm_contacts(spec)
    _add_room(spec.worldbody)
    for name, (at, to, fovy) in CAMERAS.items():
        add_camera(spec.worldbody, name, at=at, to=to, fovy=fovy)
    _add_gripper(spec)
    for colour in colours:
        _add_block(spec.worldbody, colour)
    if pad:
        spec.worldbody.add_geom(name="pad", type=mujoco.mjtGeom.mjGEOM_BOX, size=_PAD_HALF_M, pos=PAD_M)
    if distractor:
        DISTRACTORS[distractor].add(spec.worldbody, RGBA)
    return compile_scene(spec, light=light)


def _add_room(world: mujoco.MjsBody) -> None:
    add_lamp(world, direction=(-0.5, 0.35, -0.8), diffuse=0.5)
    box = mujoco.mjtGeom.mjGEOM_BOX
    half_z = 0.05
    world.add_geom(
        name="table", type=box, size=[TABLE_HALF_X_M, TABLE_HALF_Y_M, half_z], pos=[0, 0, -half_z], rgba=_TABLE
    )
    for name, size, position, rgba in (
        ("back", (0.01, 2, 2), (-0.8, 0, 0), _WALL),
        ("side", (2, 0.01, 2), (0, 0.9, 0), _WALL),
        ("floor", (2, 2, 0.01), (0, 0, -0.6), _FLOOR),
    ):
        world.add_geom(name=name, type=box, size=size, pos=position, rgba=rgba, contype=0, conaffinity=0)


def _add_gripper(spec: mujoco.MjSpec) -> None:
    folder = asset_folder("gymnasium_robotics") / "envs" / "assets" / "stls" / "fetch"
    gripper = spec.worldbody.add_body(name="gripper", quat=[1, 0, 1, 0], gravcomp=1)  # its x axis points down
    slide = mujoco.mjtJoint.mjJNT_SLIDE
    gripper.add_joint(name="gripper.y", type=slide, axis=[0, 1, 0])
    gripper.add_joint(name="gripper.z", type=slide, axis=[-1, 0, 0])
    for link, offset_m in _LINKS_M.items():
        spec.add_mesh(name=link, file=str(folder / f"{link}.stl"))
        gripper.add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=link,
            pos=[offset_m, 0, 0],
            rgba=_STEEL,
            mass=_LINK_KG,
            contype=0,
            conaffinity=0,
        )
    for side, sign in (("left", -1), ("right", 1)):
        _add_finger(gripper, side, sign)
    for joint, limits in (("gripper.y", GRIPPER_Y_M), ("gripper.z", GRIPPER_Z_M)):
        add_servo(spec, joint, limits=limits, kp=_SERVO_KP, kv=_SERVO_KV, force=_SERVO_N)
    for side in ("left", "right"):
        add_servo(spec, f"finger.{side}", limits=FINGER_M, kp=_FINGER_KP, kv=_FINGER_KV, force=_SERVO_N)


def _add_finger(gripper: mujoco.MjsBody, side: str, sign: int) -> None:
    finger = gripper.add_body(name=f"finger.{side}", pos=[0, sign * FINGER_BASE_M, 0], gravcomp=1)
    finger.add_joint(
        name=f"finger.{side}",
        type=mujoco.mjtJoint.mjJNT_SLIDE,
        axis=[0, sign, 0],
        limited=True,
        range=FINGER_M,
        armature=_FINGER_ARMATURE_KG,
    )
    finger.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=FINGER_HALF_M,
        pos=[0, sign * FINGER_HALF_M[1], 0],
        rgba=_RUBBER,
        mass=_FINGER_KG,
        condim=4,
        friction=[1.5, 0.05, 0.01],
    )


def _add_block(world: mujoco.MjsBody, colour: str) -> None:
    block = world.add_body(name=colour)
    block.add_freejoint(name=colour)
    block.add_geom(
        name=colour,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[BLOCK_M / 2] * 3,
        mass=_BLOCK_KG,
        rgba=RGBA[colour],
        condim=4,
        friction=[1.0, 0.05, 0.01],
    )
