"""`freerein-client`: what its wheel has calls a service, here beside its dependencies and nothing else of ours.

The long tests build the wheel, and install it in environments of the oldest and of the newest Python.
"""

import json
import os
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from freerein_sim.workers.vector_env import VectorEnv
from freerein_sim.worlds.tasks import tasks

pytestmark = pytest.mark.e2e
ROOT = Path(__file__).parents[2]
PYPROJECT = tomllib.loads((ROOT / "src" / "pyproject.toml").read_text())
NEWEST = PYPROJECT["project"]["dependencies"]
ROBOT = ROOT / "tests" / "compat" / "robot.py"
IMPORTED = ("numpy", "numpy.libs", "google", "grpc", "PIL", "pillow.libs", "typing_extensions.py")
"""What the dependencies of the clients are imported as, and their shared libraries."""

OLDEST = [line.partition(",")[0].replace(">=", "==") for line in NEWEST]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    if not pip(Path(sys.executable), "wheel", "--no-deps", "--wheel-dir", folder, ROOT / "src"):
        pytest.skip("what builds the wheel could not be installed")
    (built,) = folder.iterdir()
    return built


@pytest.fixture(scope="module")
def sim(start_module_service: Callable[..., Any]) -> Any:
    return start_module_service("freerein_sim", FREEREIN_SIM_WORKERS="1").until_ready()


def pip(python: Path, *arguments: str | Path) -> bool:
    command = [python, "-m", "pip", *arguments, "--quiet", "--disable-pip-version-check"]
    return subprocess.run(command, check=False).returncode == 0


def find_python(version: str) -> Path:
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"))
    candidates = [shutil.which(f"python{version}"), *sorted(pyenv.glob(f"versions/{version}.*/bin/python"))]
    for candidate in filter(None, candidates):
        asked = [candidate, "-c", "import sys; print('%d.%d' % sys.version_info[:2])"]
        if subprocess.run(asked, capture_output=True, text=True, check=False).stdout.strip() == version:
            return Path(candidate)
    pytest.skip(f"Python {version} is not on PATH nor in pyenv")


def environment(name: str, version: str, packages: list[str]) -> Path:
    """Returns the Python of an environment with these packages; kept between runs."""
    venv = ROOT / "var" / "client-venvs" / name
    python, stamp = venv / "bin" / "python", venv / "installed"
    if not stamp.exists() or stamp.read_text() != str(packages):
        subprocess.run([find_python(version), "-m", "venv", "--clear", venv], check=True)
        if not pip(python, "install", *packages):
            pytest.skip("what the clients need could not be installed")
        stamp.write_text(str(packages))
    return python


def expected_frames() -> "np.ndarray[Any, Any]":
    """Returns the frames of the robot's episode, in this process."""
    grid = tasks()["grid"]
    camera = grid.spec.cameras[0].name
    env = VectorEnv(grid, num_envs=1, seed=3)
    frames = [env.reset(seed=4, cameras=(camera,)).frames[camera]]
    frames += [env.step(np.full((1, 1), i), (camera,)).frames[camera] for i in range(3)]
    env.close()
    return np.concatenate(frames)


def test_what_the_wheel_has_calls_a_service_with_its_dependencies_alone(sim: Any, tmp_path: Path) -> None:
    for name in PYPROJECT["tool"]["hatch"]["build"]["only-include"]:
        source, target = ROOT / "src" / name, tmp_path / "wheel" / name
        target.parent.mkdir(parents=True, exist_ok=True)
        (shutil.copytree if source.is_dir() else shutil.copy)(source, target)
    imported = tmp_path / "dependencies"
    imported.mkdir()
    for name in IMPORTED:
        (imported / name).symlink_to(Path(np.__file__).parents[1] / name)
    paths = f"import runpy, sys; sys.path += {[str(tmp_path / 'wheel'), str(imported)]}"
    run_robot = f"{paths}; sys.argv = ['robot', {sim.address!r}]; runpy.run_path({str(ROBOT)!r}, run_name='__main__')"
    check_robot([sys.executable, "-I", "-S", "-W", "error", "-c", run_robot])


@pytest.mark.long
@pytest.mark.parametrize(
    ("version", "packages"),
    [pytest.param("3.10", OLDEST, id="3.10-oldest"), pytest.param("3.13", NEWEST, id="3.13-newest")],
)
def test_a_robot_with_the_clients_alone_calls_a_service(
    version: str, packages: list[str], wheel: Path, sim: Any, request: pytest.FixtureRequest
) -> None:
    python = environment(request.node.callspec.id, version, packages)
    assert pip(python, "install", "--no-deps", "--force-reinstall", wheel)
    assert pip(python, "check")
    check_robot([python, "-I", "-W", "error", ROBOT, sim.address])


def check_robot(command: list[Any]) -> None:
    """Runs a robot with the clients, and checks what it met."""
    run = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert run.returncode == 0, run.stderr
    met = json.loads(run.stdout)
    assert {"freerein.clients.services", "freerein.api.sim.v1.sim_pb2_grpc", "freerein.images"} <= set(met["modules"])
    assert "freerein.serving" not in met["modules"]
    np.testing.assert_array_equal(met["frames"], expected_frames())
    assert met["code"] == "session_not_found"
    assert "\nHint: " in met["shown"]
    assert "\nRequest id: " in met["shown"]
