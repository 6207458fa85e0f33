"""`freerein-client` as a wheel, in environments of its own: every Python that is here calls a service with it."""

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

pytestmark = [pytest.mark.e2e, pytest.mark.long]
ROOT = Path(__file__).parents[2]
NEWEST = tomllib.loads((ROOT / "src" / "pyproject.toml").read_text())["project"]["dependencies"]
OLDEST = [line.partition(",")[0].replace(">=", "==") for line in NEWEST]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    if not pip(Path(sys.executable), "wheel", "--no-deps", "--wheel-dir", folder, ROOT / "src"):
        pytest.skip("what builds the wheel could not be installed")
    (built,) = folder.iterdir()
    return built


@pytest.fixture(scope="module")
def sim(start_module_service: Callable[..., Any], wait_until: Callable[..., float]) -> Any:
    started = start_module_service("freerein_sim")
    wait_until(started.is_ready, 300)
    return started


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


@pytest.mark.parametrize(
    ("version", "packages"),
    [
        pytest.param("3.10", OLDEST, id="3.10-oldest"),
        *(pytest.param(version, NEWEST, id=f"{version}-newest") for version in ("3.10", "3.11", "3.12", "3.13")),
    ],
)
def test_a_robot_with_the_clients_alone_calls_a_service(
    version: str, packages: list[str], wheel: Path, sim: Any, request: pytest.FixtureRequest
) -> None:
    python = environment(request.node.callspec.id, version, packages)
    assert pip(python, "install", "--no-deps", "--force-reinstall", wheel)
    assert pip(python, "check")
    script = ROOT / "tests" / "compat" / "robot.py"
    command = [python, "-I", "-W", "error", script, sim.address]
    run = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert run.returncode == 0, run.stderr
    met = json.loads(run.stdout)
    assert {"freerein.clients.services", "freerein.api.sim.v1.sim_pb2_grpc", "freerein.images"} <= set(met["modules"])
    assert "freerein.serving" not in met["modules"]
    np.testing.assert_array_equal(met["frames"], expected_frames())
    assert met["code"] == "session_not_found"
    assert "\nHint: " in met["shown"]
    assert "\nRequest id: " in met["shown"]
