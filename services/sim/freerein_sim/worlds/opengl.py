"""Chooses MuJoCo's OpenGL backend. Runs before `import mujoco`, which reads MUJOCO_GL and fails without its library."""

import ctypes
import os
import subprocess
import sys
from collections.abc import Callable

from freerein.errors import FailedPrecondition, Unimplemented

_SET_BY_OPERATORS = ("MUJOCO_GL", "MUJOCO_EGL_DEVICE_ID", "PYOPENGL_PLATFORM")
_TRIAL_S = 60.0
INSTALL_HINT = "Install one: apt-get install libegl1 libgl1 (MUJOCO_GL=egl) or libosmesa6 (MUJOCO_GL=osmesa)."


def check_mujoco_gl() -> None:
    """Checks MUJOCO_GL where it is set. Raises as `choose_backend`."""
    if os.environ.get("MUJOCO_GL", "").strip():
        choose_backend()


def check_rendering() -> None:
    """Makes an OpenGL context in a child process, if the environment sets how; the setting may be wrong.

    Raises:
        FailedPrecondition: None can be made.
    """
    if not any(os.environ.get(variable, "").strip() for variable in _SET_BY_OPERATORS):
        return
    check_mujoco_gl()
    command = [sys.executable, "-m", "freerein_sim.worlds.rendering"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=_TRIAL_S, check=False)
    if done.returncode:
        detail, _, hint = (done.stderr.strip().splitlines() or [""])[-1].partition(" | ")
        raise FailedPrecondition(detail or "Expected to render; the process that tried was killed.", hint=hint)


def failure_hint(backend: str) -> str:
    """Returns what to do where MuJoCo cannot render with a backend."""
    if backend == "egl" and os.environ.get("MUJOCO_EGL_DEVICE_ID"):
        return "Correct or unset MUJOCO_EGL_DEVICE_ID."
    return "Unset MUJOCO_GL, or set it to egl or osmesa." if backend == "glfw" else INSTALL_HINT


def choose_backend() -> str:
    """Returns MUJOCO_GL where it is set, else `egl` where EGL has a device, else `osmesa`.

    Raises:
        FailedPrecondition: MUJOCO_GL or PYOPENGL_PLATFORM has an unsupported value, or there is no screen for `glfw`.
        Unimplemented: The backend's library is not installed.
    """
    chosen = os.environ.get("MUJOCO_GL", "").lower().strip()
    if chosen and chosen not in _PROBES:
        raise FailedPrecondition(
            f"Expected MUJOCO_GL to be egl, osmesa or glfw, or not set; got {chosen[:32]}.", hint="Unset MUJOCO_GL."
        )
    candidates = (chosen,) if chosen else ("egl", "osmesa")
    if chosen == "glfw" and not _has_screen():
        raise FailedPrecondition(
            "Expected a screen for MUJOCO_GL=glfw; neither DISPLAY nor WAYLAND_DISPLAY is set.",
            hint="Unset MUJOCO_GL, or set it to egl or osmesa.",
        )
    backend = next((name for name in candidates if _PROBES[name]()), "")
    if not backend:
        raise Unimplemented(
            f"Expected to render with {' or '.join(candidates)}; this machine cannot.", hint=INSTALL_HINT
        )
    if backend != "glfw" and os.environ.get("PYOPENGL_PLATFORM", "").lower() not in ("", backend):
        raise FailedPrecondition(
            f"Expected PYOPENGL_PLATFORM to be {backend}, or not set; got another value.",
            hint="Unset PYOPENGL_PLATFORM.",
        )
    return backend


def _has_osmesa() -> bool:
    return _can_load("libOSMesa.so.8") or _can_load("libOSMesa.so.6")


def _has_egl_device() -> bool:
    """Asks EGL itself: PyOpenGL commits to one platform at its import, so there is no second try."""
    if not (_can_load("libEGL.so.1") and (_can_load("libOpenGL.so.0") or _can_load("libGL.so.1"))):
        return False
    egl = ctypes.CDLL("libEGL.so.1")
    egl.eglGetProcAddress.restype = ctypes.c_void_p
    address = egl.eglGetProcAddress(b"eglQueryDevicesEXT")
    if not address:
        return False
    count = ctypes.c_int(0)
    query = ctypes.CFUNCTYPE(ctypes.c_uint, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)(address)
    return bool(query(0, None, ctypes.byref(count))) and count.value > 0


def _can_load(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def _has_screen() -> bool:
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


_PROBES: dict[str, Callable[[], bool]] = {"egl": _has_egl_device, "osmesa": _has_osmesa, "glfw": lambda: True}
