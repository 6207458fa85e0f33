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
SMALL = {  # so that a fit takes seconds
    "segmentation": ("steps=60", "batch_size=4", "features=8", "hidden_size=16", "lr=0.01", "augmentation=0"),
    "reward": ("steps=120", "batch_size=24", "augmentation=0", "evaluate_every=60"),
    "skill_cloning": ("steps=20", "features=16", "hidden_size=16", "min_segment_steps=1", "evaluate_every=20"),
    "imitation": ("steps=120", "batch_size=4", "features=16", "hidden_size=32", "embedding_size=4"),
}


@pytest.fixture
def read_blocks() -> Callable[[str, str], list[str]]:
    """Returns the blocks of a page in a language: `read_blocks("your-data", "sh")`."""
    return lambda page, language: re.findall(
        rf"^```{language}\n(.*?)^```", (ROOT / "docs" / f"{page}.md").read_text(), re.MULTILINE | re.DOTALL
    )


@pytest.fixture
def shell(
    request: pytest.FixtureRequest, start_service: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[[str], str]:
    """Runs a block with the services that the test names, and small fits; returns what it printed."""
    services = {
        name: start_service(f"freerein_{name}", tmp_path / "var", FREEREIN_SHIPPED_DIR=str(ROOT / "models"))
        for name in request.param
    }
    for name, service in services.items():
        monkeypatch.setenv(f"FREEREIN_{name.upper()}_ADDRESS", service.address)
    monkeypatch.setenv("FREEREIN_DATA_DIR", str(tmp_path / "var"))
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    fit = re.compile(r"(freerein fit (\w+) .*?--watch)")

    def small(command: str, kind: str) -> tuple[str, ...]:
        return SMALL["skill_cloning" if "skill_cloning" in command else kind]

    def run(block: str) -> str:
        for name, service in services.items():
            block = block.replace(f"localhost:{PORTS[name]}", f"127.0.0.1:{service.http_port}")
        block = fit.sub(lambda found: found[1] + "".join(f" --set {each}" for each in small(*found.groups())), block)
        command = ["bash", "-euo", "pipefail", "-c", block]
        ran = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert ran.returncode == 0, f"{block}\n{ran.stdout}\n{ran.stderr}"
        return ran.stdout

    return run
