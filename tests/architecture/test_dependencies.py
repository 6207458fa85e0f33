"""What freerein depends on: each package has a floor, and one exact version that is above it."""

import re
import tomllib
from importlib.metadata import version
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

ROOT = Path(__file__).parents[2]
MANIFESTS = [ROOT / "pyproject.toml", *sorted(ROOT.glob("services/*/pyproject.toml"))]
LINES = [line for line in (ROOT / "constraints.txt").read_text().splitlines() if not line.startswith("#")]
PINNED = {canonicalize_name(name): Version(pin) for name, _, pin in (line.partition("==") for line in LINES)}
MENDED = {"starlette": "1.3.1", "python-multipart": "0.0.34", "uvicorn": "0.51", "torch": "2.10", "pillow": "11.3"}
"""Versions in which advisories that concern a server were mended, such as those of ranges, hosts and multipart."""


def requirements() -> list[Requirement]:
    """Returns what the distributions need to run."""
    projects = [tomllib.loads(path.read_text())["project"] for path in MANIFESTS]
    lists = [[p["dependencies"], *p.get("optional-dependencies", {}).values()] for p in projects]
    found = {line for project in lists for group in project for line in group}
    return [each for each in map(Requirement, sorted(found)) if each.name != "freerein"]


@pytest.mark.fault("D1")
@pytest.mark.parametrize("requirement", requirements(), ids=str)
def test_a_package_has_a_floor_and_a_pinned_version_that_is_installed(requirement: Requirement) -> None:
    floors = [Version(each.version) for each in requirement.specifier if each.operator == ">="]
    pin = PINNED[canonicalize_name(requirement.name)]
    assert len(floors) == 1
    assert requirement.specifier.contains(pin)
    assert Version(Version(version(requirement.name)).public) == pin
    assert floors[0] >= Version(MENDED.get(requirement.name, "0"))


@pytest.mark.fault("D1")
def test_setup_and_images_install_every_package_at_one_version() -> None:
    assert all(re.fullmatch(r"[A-Za-z0-9._-]+==[0-9][A-Za-z0-9.]*", line) for line in LINES)
    assert len(PINNED) == len(LINES)
    assert "constraints.txt" in (ROOT / "Dockerfile").read_text()
    assert "constraints.txt" in (ROOT / "tools" / "setup").read_text()
