"""Compiled MuJoCo scenes, and their simulation, snapshots and rendering."""

import hashlib
import importlib.util
import logging
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from freerein.errors import FailedPrecondition
from freerein_sim.worlds import generators
from freerein_sim.worlds.camera_moves import CameraMove
from freerein_sim.worlds.rendering import Renderer, gray, open_renderer
from freerein_sim.worlds.world import Frame, MakeExpert, ScriptedPolicy, WorldSpec, check_view, foreign_snapshot

_log = logging.getLogger(__name__)

_STATE = mujoco.mjtState.mjSTATE_INTEGRATION
_DIVERGED = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)
_HEADER = struct.Struct("<4sI")
_MAGIC = b"fmjc"

MakeWorldExpert = Callable[[Any, Sequence[str], np.random.Generator], ScriptedPolicy]
"""Makes an expert of a world, as `MakeExpert` does."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A compiled scene, shared by all worlds that it is made for, so the model must not be modified.

    The fingerprint is a hash of the model and MuJoCo's version.
    """

    model: mujoco.MjModel
    fingerprint: str


class MujocoSimulation:
    """Simulates one scene for one world.

    Attributes:
        fingerprint: The scene's.
        data: The current state.
    """

    def __init__(self, spec: WorldSpec, scene: Scene, camera_move: CameraMove | None = None) -> None:
        mujoco.set_mju_user_warning(_log.warning)  # else MuJoCo writes MUJOCO_LOG.TXT where the process runs
        self.fingerprint = scene.fingerprint
        self._model = scene.model
        self.data = mujoco.MjData(scene.model)
        self._spec = spec
        self._renderer: Renderer | None = None
        self._camera_move = camera_move

    def reset(self, rng: np.random.Generator) -> None:
        """Sets the model's initial state, and forgets a divergence; call `refresh` after changing the state.

        Cameras move as drawn from a jump of `rng`, so that an episode begins as it does where they do not move.
        """
        mujoco.mj_resetData(self._model, self.data)
        if self._camera_move is not None:
            self._camera_move.draw(generators.jumped(rng))

    def step(self, substeps: int) -> bool:
        """Simulates; returns whether the simulation has diverged. Call `refresh` before rendering."""
        mujoco.mj_step(self._model, self.data, nstep=substeps)
        return any(self.data.warning[kind].number for kind in _DIVERGED)

    def refresh(self) -> None:
        """Updates the poses of bodies and cameras, which MuJoCo leaves at the start of the last substep."""
        mujoco.mj_kinematics(self._model, self.data)
        mujoco.mj_camlight(self._model, self.data)
        if self._camera_move is not None:
            self._camera_move.apply(self.data)

    def render(self, camera: str, *, height: int, width: int) -> Frame:
        """Returns the camera's image, gray where the spec's camera has one channel.

        The first call opens an OpenGL context on the calling thread.
        """
        check_view(self._spec, camera, height=height, width=width)
        if self._renderer is None:
            self._renderer = open_renderer(self._model)
        frame = self._renderer.render(self.data, camera, height=height, width=width)
        channels = next(each.channels for each in self._spec.cameras if each.name == camera)
        return gray(frame) if channels == 1 else frame

    def snapshot(self) -> bytes:
        """Returns MuJoCo's complete integration state, and how the cameras have moved."""
        state = np.empty(mujoco.mj_stateSize(self._model, _STATE))
        mujoco.mj_getState(self._model, self.data, state, _STATE)
        if self._camera_move is not None:
            state = np.append(state, self._camera_move.directions)
        return _HEADER.pack(_MAGIC, state.size) + state.astype("<f8").tobytes()

    def restore(self, snapshot: bytes) -> None:
        """Sets the state that `snapshot` returned. Raises InvalidInput for bytes that are no state of this model."""
        integrated = mujoco.mj_stateSize(self._model, _STATE)
        size = integrated + (0 if self._camera_move is None else self._camera_move.directions.size)
        if len(snapshot) != _HEADER.size + 8 * size or _HEADER.unpack_from(snapshot) != (_MAGIC, size):
            raise foreign_snapshot(f"a snapshot of this world, {_HEADER.size + 8 * size} bytes")
        state = np.frombuffer(snapshot, "<f8", offset=_HEADER.size).astype(np.float64)
        if not np.isfinite(state).all():
            raise foreign_snapshot("a snapshot of finite numbers", "one that is not")
        if self._camera_move is not None:
            self._camera_move.restore(state[integrated:])
        mujoco.mj_resetData(self._model, self.data)
        mujoco.mj_setState(self._model, self.data, state[:integrated], _STATE)
        self.refresh()

    def close(self) -> None:
        """Frees the OpenGL context, on the thread that rendered; may be called twice."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None


class MujocoWorld:
    """Base of worlds over a `MujocoSimulation`. Experts are passed in: they import worlds, never the other way.

    Args:
        spec: The task's spec.
        scene: The compiled scene.
        make_expert: Makes its experts; None for a task without.
        camera_move: How its cameras move, if they do.
    """

    steps = None

    def __init__(
        self,
        spec: WorldSpec,
        scene: Scene,
        make_expert: MakeWorldExpert | None = None,
        camera_move: CameraMove | None = None,
    ) -> None:
        self.spec = spec
        self._make_expert = make_expert
        self._simulation = simulation = MujocoSimulation(spec, scene, camera_move)
        self.fingerprint, self._data = simulation.fingerprint, simulation.data
        self.render, self.close = simulation.render, simulation.close

    @property
    def expert(self) -> MakeExpert | None:
        """Makes experts; None in a world without."""
        return self._make_expert and partial(self._make_expert, self)

    def snapshot(self) -> bytes:
        """Returns the complete state."""
        return self._simulation.snapshot()

    def restore(self, snapshot: bytes) -> None:
        """Restores a snapshot, after checking every number."""
        self._simulation.restore(snapshot)


def compile_scene(spec: mujoco.MjSpec, *, light: float = 1.0) -> Scene:
    """Compiles a scene: drawn without shadows and multisampling; divergence is reported, never reset away.

    Args:
        spec: The scene; changed.
        light: Factor of all lights' diffuse and ambient parts.
    """
    for each in (spec.visual.headlight, *spec.lights):
        each.diffuse, each.ambient = light * np.asarray(each.diffuse), light * np.asarray(each.ambient)
    spec.visual.quality.shadowsize = 0
    spec.visual.quality.offsamples = 0
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    model = spec.compile()
    compiled = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, compiled)
    return Scene(model, hashlib.sha256(mujoco.mj_versionString().encode() + compiled.tobytes()).hexdigest())


def asset_folder(package: str, *, listed_in: str = "assets.txt") -> Path:
    """Returns the folder of a package whose files are read as data, without importing it.

    Args:
        package: The package's name.
        listed_in: The requirements file of its wheel: `assets.txt`, or `assets-robots.txt` for what is optional.

    Raises:
        FailedPrecondition: It is not installed.
    """
    found = importlib.util.find_spec(package)
    if found is None or found.origin is None:
        raise FailedPrecondition(
            f"This world reads files of the wheel {package.replace('_', '-')}, which is not installed.",
            hint=f"pip install --no-deps -r {listed_in}",
        )
    return Path(found.origin).parent
