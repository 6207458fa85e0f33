"""Environments in child processes, and an installation without Gymnasium; each in an interpreter of its own."""

import subprocess
import sys
from collections.abc import Callable
from typing import Any

import pytest

MAKE_ASYNC = """
import sys
import gymnasium
import freerein.envs

def main():
    address, context, state = sys.argv[1:]
    first = gymnasium.make("freerein/grid-v0", address=address)
    first.reset()
    if state == "closed":
        first.close()
    envs = gymnasium.make_vec(
        "freerein/grid-v0", 2, "async", address=address, vector_kwargs={"context": context, "shared_memory": False}
    )
    envs.reset(seed=1)
    envs.step(envs.action_space.sample())
    envs.close()

if __name__ == "__main__":
    main()
"""


@pytest.fixture(scope="module")
def address(start_module_service: Callable[..., Any], wait_until: Callable[..., float]) -> str:
    service = start_module_service("freerein_sim", FREEREIN_SIM_WORKERS="1")
    wait_until(service.is_ready, 300)
    return str(service.address)


def run_python(*arguments: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run([sys.executable, *arguments], capture_output=True, text=True, check=False, timeout=300)


@pytest.mark.e2e
@pytest.mark.parametrize(
    ("context", "state"),
    [("fork", "closed"), ("spawn", "open"), pytest.param("forkserver", "open", marks=pytest.mark.long)],
)
def test_environments_of_child_processes_work(address: str, context: str, state: str, tmp_path: Any) -> None:
    script = tmp_path / "make_async.py"
    script.write_text(MAKE_ASYNC)
    ran = run_python(str(script), address, context, state)
    assert ran.returncode == 0, ran.stderr


@pytest.mark.e2e
def test_a_child_forked_while_an_environment_is_open_says_what_to_do(address: str) -> None:
    ran = run_python("-c", MAKE_ASYNC, address, "fork", "open")
    assert ran.returncode == 1
    assert "must be started by spawn or forkserver" in ran.stderr


@pytest.mark.e2e
def test_an_environment_is_of_no_use_in_a_forked_child(address: str) -> None:
    script = f"""
import os
import freerein.envs
from freerein.errors import FailedPrecondition
env = freerein.envs.SimEnv("grid", {address!r})
if child := os.fork():
    _, status = os.waitpid(child, 0)
    env.reset()
    assert os.waitstatus_to_exitcode(status) == 7
    env.close()
else:
    try:
        env.reset()
    except FailedPrecondition as error:
        print(error)
        os._exit(7)
    os._exit(1)
"""
    ran = run_python("-W", "ignore", "-c", script)
    assert ran.returncode == 0, ran.stderr


def test_without_gymnasium_the_error_names_what_to_install() -> None:
    ran = run_python("-c", "import sys; sys.modules['gymnasium'] = None; import freerein.envs")
    assert "needs gymnasium, which is not installed: pip install 'freerein[envs]'" in ran.stderr
