"""The MuJoCo model of a rope on a table, and of the hand that lifts it. x points right, y up in the picture, z up.

The rope is a chain of capsules with bending springs, and twists at every third joint; neighbours do not collide. Balls
at the ends of its links carry it on the table: a capsule there would have two contacts, and the step take twice as
long. The hand is a body without a shape, to which the middle of one link at a time is tied.
"""

from functools import lru_cache

import mujoco
import numpy as np

from freerein_sim.worlds.mujoco_world import Scene, compile_scene
from freerein_sim.worlds.rope.spec import LINK_M, LINKS, RADIUS_M
from freerein_sim.worlds.scenes import add_lamp, new_scene

TIMESTEP_S = 0.005
HAND = "hand"
_KG = 0.16 / LINKS
_BEND_NM, _BEND_NMS, _ARMATURE, _FIRST_ARMATURE = 0.001, 0.0006, 1e-5, 1e-6
"""Stiffness and damping of a joint, and the inertia that keeps light links stable at this time step."""

_MOST_BEND_DEG = 70.0
_TWIST_EVERY = 3
_TABLE_FRICTION, _ROPE_FRICTION = (1.0, 0.005, 0.0001), (0.3, 0.005, 0.0001)
_TABLE_BIT, _ROPE_BIT = 1, 2
_CAMERA_M, _FOVY_DEG = 1.6, 25.4
_HIDDEN = 4
"""Group of what no camera draws."""

_TABLE = (0.16, 0.20, 0.18, 1)
_COLOURS = np.array([[0.95, 0.18, 0.10], [1.0, 0.78, 0.12], [0.97, 0.97, 0.92], [0.20, 0.72, 0.95], [0.22, 0.24, 0.92]])
"""Along the rope, so that a picture shows which strand is on top where it crosses itself."""

_GEOM, _JOINT = mujoco.mjtGeom, mujoco.mjtJoint


@lru_cache(maxsize=8)
def build(*, light: float = 1.0) -> Scene:
    """Returns the scene. Cached, since compiling takes time."""
    spec = new_scene(timestep_s=TIMESTEP_S, ambient=0.3, diffuse=0.6, znear=0.1, zfar=4)
    spec.option.iterations, spec.option.tolerance = 10, 1e-6
    world = spec.worldbody
    add_lamp(world, direction=(-0.4, -0.5, -0.8), diffuse=0.35)
    world.add_camera(name="above", pos=[0, 0, _CAMERA_M], fovy=_FOVY_DEG)  # looks down, y up in the picture
    top = {"size": [2, 2, 0.1], "rgba": _TABLE, "friction": _TABLE_FRICTION}
    world.add_geom(name="table", type=_GEOM.mjGEOM_PLANE, contype=_TABLE_BIT, conaffinity=_TABLE_BIT, **top)
    world.add_body(name=HAND, mocap=True).add_site(name=HAND, group=_HIDDEN)
    _add_rope(spec)
    return compile_scene(spec, light=light)


def link_name(link: int) -> str:
    """Returns the name of a link's body, of its site, and of its tie to the hand."""
    return f"link-{link:02}"


def bend_name(link: int) -> str:
    """Returns the name of the joint by which a link, flat on the table, is turned from the one before."""
    return f"bend-z-{link:02}"


def _add_rope(spec: mujoco.MjSpec) -> None:
    body = spec.worldbody
    for link in range(LINKS):
        body = body.add_body(name=link_name(link), pos=[LINK_M if link else 0, 0, 0])
        _add_joints(body, link)
        _add_link(body, link)
        spec.add_equality(
            name=link_name(link),
            type=mujoco.mjtEq.mjEQ_CONNECT,
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            name1=link_name(link),
            name2=HAND,
            active=False,
        )
        if link >= 2:
            spec.add_exclude(bodyname1=link_name(link - 2), bodyname2=link_name(link))


def _add_joints(body: mujoco.MjsBody, link: int) -> None:
    if link == 0:
        body.add_joint(name="rope", type=_JOINT.mjJNT_FREE, armature=_FIRST_ARMATURE)
        return
    bend = {"stiffness": [_BEND_NM, 0, 0], "damping": [_BEND_NMS, 0, 0], "armature": _ARMATURE}
    bounds = {"limited": True, "range": (-_MOST_BEND_DEG, _MOST_BEND_DEG)}
    for name, axis in ((bend_name(link), (0, 0, 1)), (f"bend-y-{link:02}", (0, 1, 0))):
        body.add_joint(name=name, type=_JOINT.mjJNT_HINGE, axis=axis, **bounds, **bend)
    if link % _TWIST_EVERY == 0:
        body.add_joint(name=f"twist-{link:02}", type=_JOINT.mjJNT_HINGE, axis=(1, 0, 0), **bend)


def _add_link(body: mujoco.MjsBody, link: int) -> None:
    colour = [np.interp(link / (LINKS - 1), np.linspace(0, 1, len(_COLOURS)), channel) for channel in _COLOURS.T]
    body.add_geom(
        type=_GEOM.mjGEOM_CAPSULE,
        fromto=[0, 0, 0, LINK_M, 0, 0],
        size=[RADIUS_M, 0, 0],
        mass=_KG,
        rgba=[*colour, 1],
        contype=_ROPE_BIT,
        conaffinity=_ROPE_BIT,
        friction=_ROPE_FRICTION,
    )
    for at in (0, LINK_M) if link == LINKS - 1 else (0,):
        ball = {"pos": [at, 0, 0], "size": [RADIUS_M, 0, 0], "mass": 0, "rgba": [*colour, 1]}
        body.add_geom(type=_GEOM.mjGEOM_SPHERE, contype=_TABLE_BIT, conaffinity=0, friction=_TABLE_FRICTION, **ball)
    body.add_site(name=link_name(link), pos=[LINK_M / 2, 0, 0], group=_HIDDEN)
