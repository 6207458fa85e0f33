"""The MuJoCo model of keypad and arm; the Jaco's bodies and meshes come from the dm-control wheel.

Its fingers are closed and have no joints. A rubber ball on their tips is all of the arm that touches the keypad. The
drives are not the wheel's, whose rotors are too heavy for the arm's torques to turn in time: ours have lighter rotors,
and viscous instead of dry friction, so that a constant torque soon gives a constant speed. They compensate gravity.
"""

from functools import lru_cache
from pathlib import Path

import mujoco
import numpy as np

from freerein_sim.worlds.conditions import LIGHTS
from freerein_sim.worlds.dial import keypad
from freerein_sim.worlds.dial.spec import TORQUE_NM
from freerein_sim.worlds.mujoco_world import Scene, asset_folder, compile_scene
from freerein_sim.worlds.scenes import add_camera, add_lamp, new_scene

JOINTS = tuple(f"arm.joint_{number}" for number in range(1, 7))
FINGERTIP = "arm.hand.fingertip"
HOME_RAD = (0.12, 2.56, 4.44, 0.43, -1.5, 0.0)
"""Angles of the joints around which episodes begin: the fingertip is over the middle of the keypad, pointing down."""

TIMESTEP_S = 0.004

_ARMATURE_KG_M2 = (0.3,) * 3 + (0.08,) * 3
_DAMPING_NM_S = (8.0,) * 3 + (2.0,) * 3
_TIP_RADIUS_M = 0.014
_TIP_M = (0.004, 0.0005, -0.205)
_CLOSED_RAD = 1.1
_CAMERA_AT_M, _CAMERA_TO_M, _CAMERA_FOVY = (1.45, 0.65, 1.2), (0.37, -0.02, 0.22), 34.0
_KEY_KG, _KEY_STIFFNESS, _KEY_DAMPING = 0.1, 300.0, 4.0
_BOARD_HALF_M = (0.26, 0.20, 0.02)
_BOARD, _TABLE, _WALL = (0.16, 0.16, 0.18, 1), (0.42, 0.42, 0.44, 1), (0.62, 0.62, 0.64, 1)
_RUBBER, _SHELL = (1.0, 1.0, 1.0, 1), (0.30, 0.30, 0.32, 1)
_UP, _FACES = 4, 6
"""The upper one of a cube texture's faces, and their number."""

_BOX = mujoco.mjtGeom.mjGEOM_BOX
_TOUCHED, _TOUCHING = {"contype": 0, "conaffinity": 1}, {"contype": 1, "conaffinity": 0}
_APART = {"contype": 0, "conaffinity": 0}


@lru_cache(maxsize=1 + len(LIGHTS))
def build(*, light: float = 1.0) -> Scene:
    """Returns the scene, under a factor of all lights. Cached, since compiling takes a tenth of a second.

    Raises:
        FailedPrecondition: The wheel dm-control is not installed.
    """
    spec = new_scene(timestep_s=TIMESTEP_S, ambient=0.35, diffuse=0.35, znear=0.05, zfar=10)
    _add_room(spec.worldbody)
    for digit in keypad.DIGITS:
        _add_key(spec, digit)
    _add_arm(spec, asset_folder("dm_control") / "third_party" / "kinova")
    return compile_scene(spec, light=light)


def _add_room(world: mujoco.MjsBody) -> None:
    add_lamp(world, direction=(-0.5, -0.3, -0.8), diffuse=0.5)
    world.add_geom(name="table", type=_BOX, size=[1.5, 1.5, 0.05], pos=[0.5, 0, -0.05], rgba=_TABLE, **_TOUCHED)
    world.add_geom(name="wall", type=_BOX, size=[0.05, 2.5, 2], pos=[-0.6, 0, 0], rgba=_WALL, **_APART)
    board = (0.5, 0, _BOARD_HALF_M[2])
    world.add_geom(name="board", type=_BOX, size=_BOARD_HALF_M, pos=board, rgba=_BOARD, **_TOUCHED)
    add_camera(world, "front", at=_CAMERA_AT_M, to=_CAMERA_TO_M, fovy=_CAMERA_FOVY)


def _add_key(spec: mujoco.MjSpec, digit: int) -> None:
    name = f"key-{digit}"
    top = keypad.face(digit)
    sides = np.full((_FACES, *top.shape), top[0, 0])
    sides[_UP] = np.rot90(top)  # its upper edge is towards the arm
    texture = spec.add_texture(name=name, type=mujoco.mjtTexture.mjTEXTURE_CUBE, nchannel=3)
    texture.width, texture.height = top.shape[1], _FACES * top.shape[0]
    texture.data = sides.tobytes()
    material = spec.add_material(name=name, specular=0.0)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
    half_z = keypad.KEY_HALF_M[2]
    key = spec.worldbody.add_body(name=name, pos=[*keypad.centre(digit), keypad.TOP_M - half_z], gravcomp=1)
    key.add_joint(
        name=name,
        type=mujoco.mjtJoint.mjJNT_SLIDE,
        axis=[0, 0, 1],
        limited=True,
        range=[-keypad.TRAVEL_M, 0.01],
        stiffness=_KEY_STIFFNESS,
        damping=_KEY_DAMPING,
    )
    key.add_geom(name=name, type=_BOX, size=keypad.KEY_HALF_M, mass=_KEY_KG, material=name, **_TOUCHED)


def _add_arm(spec: mujoco.MjSpec, folder: Path) -> None:
    arm = _load(folder / "jaco_arm.xml")
    arm.attach(_closed_hand(folder), site=arm.site("wristsite"), prefix="hand.")
    for joint, armature, damping in zip(arm.joints, _ARMATURE_KG_M2, _DAMPING_NM_S, strict=True):
        joint.armature, joint.damping[0], joint.frictionloss = armature, damping, 0
    spec.attach(arm, frame=spec.worldbody.add_frame(), prefix="arm.")
    for name, torque in zip(JOINTS, TORQUE_NM, strict=True):
        motor = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.gear[0] = torque
        motor.ctrllimited, motor.ctrlrange = True, (-1, 1)


def _load(path: Path) -> mujoco.MjSpec:
    """Returns a part of the arm, which weighs nothing and touches nothing, without its material for sites."""
    part = mujoco.MjSpec.from_file(str(path))
    for site in part.sites:
        site.material = ""
    part.delete(part.material("reference_site"))
    for body in part.bodies[1:]:
        body.gravcomp = 1
    for geom in part.geoms:
        geom.contype = geom.conaffinity = 0
    part.material("dark_gray").rgba = _SHELL
    return part


def _closed_hand(folder: Path) -> mujoco.MjSpec:
    """Returns the hand, its fingers bent and without joints, and a ball on their tips."""
    hand = _load(folder / "jaco_hand.xml")
    bent = np.array([np.cos(_CLOSED_RAD / 2), 0, 0, np.sin(_CLOSED_RAD / 2)])
    for joint in list(hand.joints):
        finger = joint.parent
        closed = np.empty(4)
        mujoco.mju_mulQuat(closed, finger.quat / np.linalg.norm(finger.quat), bent)
        finger.quat = closed
        hand.delete(joint)
    palm = hand.body("hand")
    palm.add_site(name="fingertip", pos=_TIP_M, material="")
    palm.add_geom(
        name="fingertip",
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=[_TIP_RADIUS_M, 0, 0],
        pos=_TIP_M,
        mass=0.02,
        rgba=_RUBBER,
        material="",
        **_TOUCHING,
    )
    return hand
