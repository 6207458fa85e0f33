"""Offscreen MuJoCo rendering, tuned for software OpenGL.

Shadows, reflections, haze, skybox and multisampling are off, and the offscreen buffer has the requested size.
"""

import importlib
import sys
import threading
from typing import Any

import mujoco
import numpy as np

from freerein.errors import FailedPrecondition, ServiceError, Unimplemented
from freerein_sim.worlds.opengl import choose_backend, failure_hint
from freerein_sim.worlds.world import Frame

_OFF = (
    mujoco.mjtRndFlag.mjRND_SHADOW,
    mujoco.mjtRndFlag.mjRND_REFLECTION,
    mujoco.mjtRndFlag.mjRND_SKYBOX,
    mujoco.mjtRndFlag.mjRND_HAZE,
)

_FAILURES = (ImportError, AttributeError, OSError, RuntimeError, ValueError, UserWarning, mujoco.FatalError)
"""Errors of PyOpenGL, GLFW and MuJoCo."""

_GL_RENDERER = 0x1F01
_LONGEST_SENTENCE = 300
_LUMA_THOUSANDTHS = np.array([299, 587, 114], np.uint32)


class Renderer:
    """OpenGL context of one model on one thread, shared by all worlds of the model; saves ten megabytes per world.

    Created by `open_renderer`.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self.uses = 0
        self._thread = threading.get_ident()
        self._model = model
        self._gl, self._context = _open_gl(model)
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
        Unimplemented: This machine has neither EGL nor OSMesa, or what it has cannot render.
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


def _open_gl(model: mujoco.MjModel) -> tuple[Any, mujoco.MjrContext]:
    """Returns an OpenGL context, and MuJoCo's in it."""
    backend = choose_backend()
    size_px = max(model.vis.global_.offwidth, model.vis.global_.offheight)
    try:
        gl = importlib.import_module(f"mujoco.{backend}").GLContext(size_px, size_px)
        gl.make_current()
        return gl, mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_50)
    except _FAILURES as error:
        said = " ".join(str(error).split()).rstrip(".")[:_LONGEST_SENTENCE]
        raise Unimplemented(
            f"Expected to render with {backend}; MuJoCo cannot: {said}.", hint=failure_hint(backend)
        ) from error


def main() -> None:
    """Renders nothing, and writes with what; ends with 1, and the reason and a hint on one line, where it cannot."""
    try:
        renderer = open_renderer(mujoco.MjModel.from_xml_string("<mujoco/>"))
    except ServiceError as error:
        sys.exit(f"{error.detail} | {error.hint}")
    device = importlib.import_module("OpenGL.GL").glGetString(_GL_RENDERER).decode()
    renderer.close()
    sys.stdout.write(f"{choose_backend()}: {device}\n")


if __name__ == "__main__":
    main()
