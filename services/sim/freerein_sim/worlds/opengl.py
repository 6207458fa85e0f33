"""Chooses how MuJoCo renders without a screen. Must run before `import mujoco`, which reads MUJOCO_GL and may fail."""

import ctypes
import os

from freerein.errors import FailedPrecondition, Unimplemented

INSTALL_HINT = "Install one: apt-get install libegl1 libgl1 (MUJOCO_GL=egl) or libosmesa6 (MUJOCO_GL=osmesa)."
_BACKENDS = ("egl", "osmesa", "glfw")


def check_mujoco_gl() -> None:
    """Checks MUJOCO_GL where it is set.

    Raises:
        FailedPrecondition: MUJOCO_GL or PYOPENGL_PLATFORM has a value that cannot be used.
        Unimplemented: The library of the backend is not installed.
    """
    asked = _asked()
    if asked and asked not in _BACKENDS:
        raise FailedPrecondition(
            f"Expected MUJOCO_GL to be egl, osmesa or glfw, or not set; got {asked[:32]}.", hint="Unset MUJOCO_GL."
        )
    if (asked == "egl" and not _has_egl_device()) or (asked == "osmesa" and not _has_osmesa()):
        raise Unimplemented(
            f"Expected to render with MUJOCO_GL={asked}; this machine cannot.",
            hint=INSTALL_HINT,
        )
    if asked in ("egl", "osmesa"):
        _check_pyopengl_platform(asked)


def choose_backend() -> str:
    """Returns MUJOCO_GL where it is set, else `egl` where EGL has a device, else `osmesa`.

    Raises:
        FailedPrecondition: MUJOCO_GL or PYOPENGL_PLATFORM has a value that cannot be used.
        Unimplemented: The library of the backend is not installed.
    """
    check_mujoco_gl()
    if asked := _asked():
        return asked
    backend = "egl" if _has_egl_device() else "osmesa"
    if backend == "osmesa" and not _has_osmesa():
        raise Unimplemented("Expected to render with EGL or OSMesa; this machine has neither.", hint=INSTALL_HINT)
    _check_pyopengl_platform(backend)
    return backend


def _asked() -> str:
    return os.environ.get("MUJOCO_GL", "").lower().strip()


def _check_pyopengl_platform(backend: str) -> None:
    if os.environ.get("PYOPENGL_PLATFORM", backend).lower() not in ("", backend):
        raise FailedPrecondition(
            f"Expected PYOPENGL_PLATFORM to be {backend}, or not set; it is something else.",
            hint="Unset PYOPENGL_PLATFORM.",
        )


def _has_osmesa() -> bool:
    return any(_can_load(f"libOSMesa.so.{version}") for version in (8, 6))


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
