"""Parts of MuJoCo scenes: an empty one, and lamps, cameras and servos that are put into it."""

from collections.abc import Sequence

import mujoco
import numpy as np


def new_scene(*, timestep_s: float, ambient: float, diffuse: float, znear: float, zfar: float) -> mujoco.MjSpec:
    """Returns an empty scene with a headlight of these brightnesses, without highlights."""
    spec = mujoco.MjSpec()
    spec.option.timestep = timestep_s
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [ambient] * 3, [diffuse] * 3
    spec.visual.headlight.specular = [0.0] * 3
    spec.visual.map.znear, spec.visual.map.zfar = znear, zfar
    return spec


def use_firm_contacts(spec: mujoco.MjSpec) -> None:
    """Lets friction hold what a gripper carries: elliptic cones, and little slip."""
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 10


def add_lamp(world: mujoco.MjsBody, *, direction: Sequence[float], diffuse: float, name: str = "") -> None:
    """Adds a directional light without shadows."""
    world.add_light(
        name=name,
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        dir=direction,
        diffuse=[diffuse] * 3,
        specular=[0.1] * 3,
        castshadow=False,
    )


def add_camera(world: mujoco.MjsBody, name: str, *, at: Sequence[float], to: Sequence[float], fovy: float) -> None:
    """Adds a camera that looks from one point to another, upright, with a vertical field of view in degrees."""
    backward = np.subtract(at, to)
    right = np.cross((0, 0, 1), backward)
    axes = np.stack([right, np.cross(backward, right), backward], axis=1)
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, (axes / np.linalg.norm(axes, axis=0)).ravel())
    world.add_camera(name=name, pos=at, quat=quaternion, fovy=fovy)


def add_servo(
    spec: mujoco.MjSpec,
    joint: str,
    *,
    kp: float,
    kv: float,
    limits: tuple[float, float] | None = None,
    force: float | None = None,
) -> None:
    """Adds a position servo of a joint, its set-points within limits and its force or torque at most `force`."""
    servo = spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    servo.set_to_position(kp=kp, kv=kv)
    if limits is not None:
        servo.ctrllimited, servo.ctrlrange = True, limits
    if force is not None:
        servo.forcelimited, servo.forcerange = True, (-force, force)
