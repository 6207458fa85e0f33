"""Offscreen MuJoCo rendering, tuned for software OpenGL.

Shadows, reflections, haze, skybox and multisampling are off, and the offscreen buffer has the requested size.
"""

import importlib
import threading
from typing import Any

import mujoco
import numpy as np

from freerein.errors import FailedPrecondition, Unimplemented
from freerein_sim.worlds.opengl import INSTALL_HINT, choose_backend
from freerein_sim.worlds.world import Frame

_OFF = (
    mujoco.mjtRndFlag.mjRND_SHADOW,
    mujoco.mjtRndFlag.mjRND_REFLECTION,
    mujoco.mjtRndFlag.mjRND_SKYBOX,
    mujoco.mjtRndFlag.mjRND_HAZE,
)

_LUMA_THOUSANDTHS = np.array([299, 587, 114], np.uint32)


class Renderer:
    """OpenGL context of one model on one thread, shared by all worlds of the model; saves ten megabytes per world.

    Created by `open_renderer`.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self.uses = 0
        self._thread = threading.get_ident()
        self._model = model
        self._gl = _open_gl(max(model.vis.global_.offwidth, model.vis.global_.offheight))
        self._gl.make_current()
        self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_50)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._scene = mujoco.MjvScene(model, _count_drawn(model))
        for flag in _OFF:
            self._scene.flags[flag] = 0
        self._option, self._perturb, self._camera = mujoco.MjvOption(), mujoco.MjvPerturb(), mujoco.MjvCamera()
        self._camera.type = mujoco.mjtCamera.mjCAMERA_FIXED

    def render(self, data: mujoco.MjData, camera: str, *, height: int, width: int) -> Frame:
        """Returns the camera's image, RGB, uint8 (height, width, 3)."""
        self._check_thread()
        self._gl.make_current()
        if (self._context.offHeight, self._context.offWidth) != (height, width):
            mujoco.mjr_resizeOffscreen(width, height, self._context)
        self._camera.fixedcamid = self._model.camera(camera).id
        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(self._model, data, self._option, self._perturb, self._camera, everything, self._scene)
        viewport = mujoco.MjrRect(0, 0, width, height)
        mujoco.mjr_render(viewport, self._scene, self._context)
        bottom_up = np.empty((height, width, 3), np.uint8)
        mujoco.mjr_readPixels(bottom_up, None, viewport, self._context)
        return np.ascontiguousarray(bottom_up[::-1])

    def close(self) -> None:
        """Ends one use; the last use frees the context. Must be called on the creating thread."""
        self._check_thread()
        self.uses -= 1
        if self.uses == 0:
            del _thread.renderers[id(self._model)]
            self._gl.make_current()
            self._context.free()
            self._gl.free()

    def _check_thread(self) -> None:
        if threading.get_ident() != self._thread:
            raise FailedPrecondition("A world is rendered and closed on one thread; this is another.")


def gray(frame: Frame) -> Frame:
    """Returns the luma of an RGB frame, .299 R + .587 G + .114 B rounded: uint8 (H, W, 3) to (H, W, 1)."""
    thousandths = frame.astype(np.uint32) @ _LUMA_THOUSANDTHS  # in integers, equal on every machine
    return ((thousandths + 500) // 1000).astype(np.uint8)[..., None]


def _count_drawn(model: mujoco.MjModel) -> int:
    """Returns the greatest number of things that MuJoCo draws of a model; it leaves out what is beyond."""
    tendons = 2 * model.nwrap  # a tendon that winds round a geom has two points there
    return int(model.ngeom + model.nsite + tendons + model.nskin + model.nflex)


def open_renderer(model: mujoco.MjModel) -> Renderer:
    """Returns this thread's renderer of the model. Every call needs one `close` on the same thread.

    Raises:
        Unimplemented: This machine has neither EGL nor OSMesa.
    """
    renderer = _thread.renderers.get(id(model))
    if renderer is None:
        renderer = _thread.renderers[id(model)] = Renderer(model)
    renderer.uses += 1
    return renderer


class _ThreadRenderers(threading.local):
    """Renderers of this thread, by `id` of their model."""

    def __init__(self) -> None:
        self.renderers: dict[int, Renderer] = {}


_thread = _ThreadRenderers()


def _open_gl(size_px: int) -> Any:
    """Returns MuJoCo's OpenGL context."""
    backend = choose_backend()
    try:
        return importlib.import_module(f"mujoco.{backend}").GLContext(size_px, size_px)
    except (ImportError, AttributeError, OSError, RuntimeError) as error:  # what PyOpenGL raises
        raise Unimplemented(f"Expected to render with {backend}; this machine cannot.", hint=INSTALL_HINT) from error
