"""The MuJoCo model of a floor: a mesh for each texture, and a camera on a body that is put where the robot is.

A mesh has the faces of all boxes of one texture. Textures of MuJoCo's own boxes smear on their sides, and a frame of
them takes about three times as long.
"""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from functools import lru_cache

import mujoco
import numpy as np
import numpy.typing as npt

from freerein_sim.worlds.mujoco_world import Scene, compile_scene
from freerein_sim.worlds.office.floors import FLOORS
from freerein_sim.worlds.office.furniture import Box
from freerein_sim.worlds.office.spec import CAMERA, CAMERA_HEIGHT_M, VIEW_DEG
from freerein_sim.worlds.office.textures.floor_textures import Texture, draw_textures
from freerein_sim.worlds.scenes import add_camera, add_lamp, new_scene

ROBOT = "robot"
_LAMPS = (((-0.5, -0.3, -0.6), 0.28), ((0.6, 0.2, 0.5), 0.14))
"""Directions, and how bright: no two sides of a box are lit alike."""

_CORNERS = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
"""Corners of a face, counter-clockwise from outside: shares of its width and of its height, from its lower left."""

_TRIANGLES = np.array([(0, 1, 2), (0, 2, 3)])
_FACES = (
    ((0, -1, 0), (1, 0, 0), (0, 0, 1)),
    ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    ((0, 1, 0), (-1, 0, 0), (0, 0, 1)),
    ((-1, 0, 0), (0, -1, 0), (0, 0, 1)),
    ((0, 0, 1), (1, 0, 0), (0, 1, 0)),
    ((0, 0, -1), (-1, 0, 0), (0, 1, 0)),
)
"""Normal, right and up of each face of a box."""

Numbers = npt.NDArray[np.float64]


@lru_cache(maxsize=8)
def build(floor: str, *, light: float = 1.0) -> Scene:
    """Returns the scene of a floor. Cached, since compiling takes time.

    Args:
        floor: Its name.
        light: Factor of all lights.
    """
    plan = FLOORS[floor]
    spec = new_scene(timestep_s=0.01, ambient=0.6, diffuse=0.0, znear=0.05, zfar=30)
    spec.stat.extent = 1.0
    for number, (direction, diffuse) in enumerate(_LAMPS):
        add_lamp(spec.worldbody, name=f"lamp-{number}", direction=direction, diffuse=diffuse)
    by_texture: defaultdict[str, list[Box]] = defaultdict(list)
    for box in plan.boxes():
        by_texture[box.texture].append(box)
    textures = draw_textures(np.random.default_rng(plan.seed + 1), plan.rooms, by_texture)
    for name, boxes in by_texture.items():
        _add_boxes(spec, name, boxes, textures[name])
    robot = spec.worldbody.add_body(name=ROBOT, mocap=True)
    add_camera(robot, CAMERA, at=(0, 0, CAMERA_HEIGHT_M), to=(1, 0, CAMERA_HEIGHT_M), fovy=VIEW_DEG)
    return compile_scene(spec, light=light)


def _add_boxes(spec: mujoco.MjSpec, name: str, boxes: Sequence[Box], texture: Texture) -> None:
    """Adds boxes of one texture as a mesh that nothing collides with."""
    height, width, _ = texture.pixels.shape
    image = spec.add_texture(
        name=name,
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        width=width,
        height=height,
        nchannel=3,
    )
    image.data = texture.pixels[::-1].tobytes()  # OpenGL's first row is the lowest
    material = spec.add_material(name=name, specular=0.0)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
    faces = [face for box in boxes for face in _faces(box, texture.tile_m)]
    vertices, normals, coordinates = (np.concatenate(part) for part in zip(*faces, strict=True))
    triangles = (4 * np.arange(len(faces))[:, None, None] + _TRIANGLES).reshape(-1, 3)
    spec.add_mesh(
        name=name,
        uservert=vertices.ravel(),
        usernormal=normals.ravel(),
        usertexcoord=coordinates.ravel(),
        userface=triangles.ravel(),
        userfacenormal=triangles.ravel(),
        userfacetexcoord=triangles.ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, material=name, contype=0, conaffinity=0)


def _faces(box: Box, tile_m: tuple[float, float] | None) -> Iterator[tuple[Numbers, Numbers, Numbers]]:
    """Yields corners (4, 3), normals (4, 3) and texture coordinates (4, 2) of a box's faces.

    Tiles begin at the world's origin, so that neighbouring boxes of one texture have no seam.
    """
    low, high = np.array(box.low), np.array(box.high)
    middle, half = (low + high) / 2, (high - low) / 2
    for normal, right, up in np.array(_FACES, np.float64):
        sides = np.stack([right, up])
        corners = middle + half * (normal + (2 * _CORNERS - 1) @ sides)
        coordinates = _CORNERS if tile_m is None else corners @ sides.T / tile_m
        yield corners, np.tile(normal, (4, 1)), coordinates.astype(np.float64)
