"""The part of an episode's look that MuJoCo's state does not hold: sizes, gray levels, light and camera.

An appearance is one vector of numbers, uniform between limits, which a world writes into its own copy of the model.
"""

from itertools import accumulate

import mujoco
import numpy as np
import numpy.typing as npt

from freerein_sim.worlds.tabletop.scene import CAMERA
from freerein_sim.worlds.tabletop.things import SCALED, SPOTS

Appearance = npt.NDArray[np.float64]
"""float64 (V,): see `_PARTS`."""

_ARM_GEOMS = ("palm", "wrist", "arm")
_PARTS: tuple[tuple[str, int, float, float], ...] = (
    ("scale", len(SCALED), 0.87, 1.13),  # factor of each thing's size
    ("contrast", len(SCALED) + 1, -1.0, 1.0),  # how each thing, and the arm, differs from the table
    ("table", 1, 0.35, 0.65),  # gray level
    ("wall", 1, 0.1, 0.9),  # gray level
    ("brightness", 2, 0.75, 1.2),  # factor of headlight and lamp
    ("lamp", 2, -0.35, 0.35),  # added to its direction, along x and y
    ("camera", 3, -0.025, 0.025),  # shift, in metres
    ("turn", 3, -0.015, 0.015),  # turn of the camera about its axes, in radians
)
LOW = np.concatenate([np.full(size, low) for _, size, low, _ in _PARTS])
HIGH = np.concatenate([np.full(size, high) for _, size, _, high in _PARTS])
_SLICES = {
    name: slice(end - size, end)
    for (name, size, _, _), end in zip(_PARTS, accumulate(size for _, size, _, _ in _PARTS), strict=True)
}
_LEAST_CONTRAST, _MORE_CONTRAST = 0.13, 0.25


def draw(rng: np.random.Generator) -> Appearance:
    """Draws an appearance."""
    return rng.uniform(LOW, HIGH)


def scales(appearance: Appearance) -> dict[str, float]:
    """Returns the factor of each thing's size."""
    return dict(zip(SCALED, appearance[_SLICES["scale"]].tolist(), strict=True))


def apply(model: mujoco.MjModel, nominal: mujoco.MjModel, appearance: Appearance) -> None:
    """Writes an appearance into a copy of the nominal model. Masses stay."""
    part = {name: appearance[each] for name, each in _SLICES.items()}
    table = float(part["table"][0])
    contrast = part["contrast"]
    grays = table + np.sign(contrast) * (_LEAST_CONTRAST + _MORE_CONTRAST * np.abs(contrast))
    for name, scale, gray in zip(SCALED, part["scale"], grays[:-1], strict=True):
        bodies = SPOTS if name == "stain" else (name,)
        geoms = np.concatenate([_geoms_of(nominal, body) for body in bodies])
        for sized in ("geom_size", "geom_pos", "geom_rbound", "geom_aabb"):
            getattr(model, sized)[geoms] = scale * getattr(nominal, sized)[geoms]
        _paint(model, nominal, geoms, gray)
    hand = np.arange(model.geom("palm").id, model.geom("palm").id + len(_ARM_GEOMS))
    _paint(model, nominal, hand, grays[-1])
    for name in ("table", "wall"):
        _paint(model, nominal, np.array([model.geom(name).id]), float(part[name][0]))
    for own in ("ambient", "diffuse"):
        getattr(model.vis.headlight, own)[:] = part["brightness"][0] * getattr(nominal.vis.headlight, own)
    model.light_diffuse[0] = part["brightness"][1] * nominal.light_diffuse[0]
    model.light_dir[0] = nominal.light_dir[0] + (*part["lamp"], 0)
    model.light_dir[0] /= np.linalg.norm(model.light_dir[0])
    camera = model.camera(CAMERA).id
    model.cam_pos[camera] = nominal.cam_pos[camera] + part["camera"]
    model.cam_quat[camera] = nominal.cam_quat[camera]
    mujoco.mju_quatIntegrate(model.cam_quat[camera], part["turn"], 1.0)


def _geoms_of(model: mujoco.MjModel, body: str) -> npt.NDArray[np.int64]:
    first = model.body(body).geomadr[0]
    return np.arange(first, first + model.body(body).geomnum[0])


def _paint(model: mujoco.MjModel, nominal: mujoco.MjModel, geoms: npt.NDArray[np.int64], gray: float) -> None:
    model.geom_rgba[geoms, :3] = gray * nominal.geom_rgba[geoms, :3]
