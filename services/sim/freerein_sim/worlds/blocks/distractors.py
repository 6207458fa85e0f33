"""Distractors: a thing in the colour of a block that no task is about, at a place drawn for each episode."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from freerein_sim.worlds.blocks.spec import COLOURS

_STORE_M = (-2.0, 0.0, 0.0)
"""Position of distractors that an episode does not show: behind the wall."""


@dataclass(frozen=True)
class Distractor:
    """A kind of distractor; it touches nothing.

    Attributes:
        geom: MuJoCo's type of its form.
        size_m: MuJoCo's sizes of that form.
        quaternion: Its orientation.
        low_m: Least x, y and z of its centre.
        high_m: Greatest x, y and z of its centre.
    """

    geom: mujoco.mjtGeom
    size_m: tuple[float, ...]
    quaternion: tuple[float, float, float, float]
    low_m: tuple[float, float, float]
    high_m: tuple[float, float, float]

    def add(self, world: mujoco.MjsBody, rgba: Mapping[str, tuple[float, float, float, float]]) -> None:
        """Adds one of each colour, in store."""
        for colour in COLOURS:
            body = world.add_body(name=_name(colour), mocap=True, pos=_STORE_M, quat=self.quaternion)
            body.add_geom(type=self.geom, size=np.resize(self.size_m, 3), rgba=rgba[colour], contype=0, conaffinity=0)

    def show(self, data: mujoco.MjData, rng: np.random.Generator) -> None:
        """Moves one from the store to a place; its colour and the place are drawn."""
        body = data.model.body(_name(COLOURS[rng.integers(len(COLOURS))]))
        data.mocap_pos[body.mocapid] = rng.uniform(self.low_m, self.high_m)


def _name(colour: str) -> str:
    return f"distractor.{colour}"


DISTRACTORS = {
    "ball": Distractor(
        mujoco.mjtGeom.mjGEOM_SPHERE, (0.028,), (1, 0, 0, 0), low_m=(-0.1, -0.2, 0.028), high_m=(-0.06, 0.2, 0.028)
    ),
    "picture": Distractor(
        mujoco.mjtGeom.mjGEOM_CYLINDER,
        (0.07, 0.004),
        (math.sqrt(0.5), 0, math.sqrt(0.5), 0),
        low_m=(-0.784, -0.33, 0.05),
        high_m=(-0.784, 0.33, 0.3),
    ),
}
"""By name: a ball on the table, behind the blocks, and a round picture on the wall."""
