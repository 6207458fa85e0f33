"""Runs the blocks of pages in `docs/` as a user does."""

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
PORTS = {"segmentation": 8101, "imitation": 8102, "reward": 8103}
SMALL = {  # so that a fit takes a second or two; a test says of how many steps it is
    "segmentation": ("batch_size=4", "features=8", "hidden_size=16", "lr=0.01", "augmentation=0"),
    "reward": ("batch_size=24", "augmentation=0", "evaluate_every=50"),
    "skill_cloning": ("steps=5", "features=16", "hidden_size=16", "min_segment_steps=1", "evaluate_every=5"),
    "imitation": ("batch_size=4", "features=16", "hidden_size=32", "embedding_size=4"),
}


@pytest.fixture
def read_blocks() -> Callable[[str, str], list[str]]:
    """Returns the blocks of a page in a language: `read_blocks("your-data", "sh")`."""
    return lambda page, language: re.findall(
        rf"^```{language}\n(.*?)^```", (ROOT / "docs" / f"{page}.md").read_text(), re.MULTILINE | re.DOTALL
    )


@pytest.fixture
def commands(tmp_path: Path) -> Path:
    """A folder for `PATH` with `freerein`, and `freerein-python BLOCK`: `forked.py`, once a service was started."""
    folder = tmp_path / "bin"
    folder.mkdir()
    for name, program in (("freerein", "freerein"), ("freerein-python", "python")):
        (folder / name).write_text(
            f'#!/bin/sh\nexec {sys.executable} -S {Path(__file__).with_name("forked.py")} {program} "$@"\n'
        )
        (folder / name).chmod(0o755)
    return folder


@pytest.fixture
def shell(
    request: pytest.FixtureRequest,
    start_service: Callable[..., Any],
    commands: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> Callable[[str], str]:
    """Runs a block with the services that the test names, and fits of so many steps; returns what it printed."""
    services = {
        name: start_service(f"freerein_{name}", tmp_path / "var", FREEREIN_SHIPPED_DIR=str(ROOT / "models"))
        for name in request.param
    }
    for name, service in services.items():
        monkeypatch.setenv(f"FREEREIN_{name.upper()}_ADDRESS", service.address)
    monkeypatch.setenv("FREEREIN_DATA_DIR", str(tmp_path / "var"))
    monkeypatch.setenv("PATH", f"{commands}:{Path(sys.executable).parent}:{os.environ['PATH']}")
    fit = re.compile(r"(freerein fit (\w+) .*?--watch)")

    def small(command: str, kind: str) -> tuple[str, ...]:
        if "skill_cloning" in command:
            return SMALL["skill_cloning"]
        return (f"steps={request.param[kind]}", *SMALL[kind])

    def run(block: str) -> str:
        for name, service in services.items():
            block = block.replace(f"localhost:{PORTS[name]}", f"127.0.0.1:{service.http_port}")
        block = fit.sub(lambda found: found[1] + "".join(f" --set {each}" for each in small(*found.groups())), block)
        command = ["bash", "-euo", "pipefail", "-c", block]
        ran = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert ran.returncode == 0, f"{block}\n{ran.stdout}\n{ran.stderr}"
        return ran.stdout

    return run
