"""Chooses MuJoCo's OpenGL backend. Runs before `import mujoco`, which reads MUJOCO_GL and fails without its library."""

import ctypes
import os
from collections.abc import Callable

from freerein.errors import FailedPrecondition, Unimplemented

INSTALL_HINT = "Install one: apt-get install libegl1 libgl1 (MUJOCO_GL=egl) or libosmesa6 (MUJOCO_GL=osmesa)."


def check_mujoco_gl() -> None:
    """Checks MUJOCO_GL where it is set. Raises as `choose_backend`."""
    if os.environ.get("MUJOCO_GL", "").strip():
        choose_backend()


def choose_backend() -> str:
    """Returns MUJOCO_GL where it is set, else `egl` where EGL has a device, else `osmesa`.

    Raises:
        FailedPrecondition: MUJOCO_GL or PYOPENGL_PLATFORM has an unsupported value.
        Unimplemented: The backend's library is not installed.
    """
    chosen = os.environ.get("MUJOCO_GL", "").lower().strip()
    if chosen and chosen not in _PROBES:
        raise FailedPrecondition(
            f"Expected MUJOCO_GL to be egl, osmesa or glfw, or not set; got {chosen[:32]}.", hint="Unset MUJOCO_GL."
        )
    candidates = (chosen,) if chosen else ("egl", "osmesa")
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


_PROBES: dict[str, Callable[[], bool]] = {"egl": _has_egl_device, "osmesa": _has_osmesa, "glfw": lambda: True}
"""`glfw` fails on its own without a screen."""
