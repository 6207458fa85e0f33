"""What freerein depends on: each package has a floor, and one exact version that is above it."""

import re
import sys
import tomllib
from importlib.metadata import packages_distributions, version
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

ROOT = Path(__file__).parents[2]
MANIFESTS = [ROOT / "pyproject.toml", ROOT / "src/pyproject.toml", *sorted(ROOT.glob("services/*/pyproject.toml"))]
LINES = [line for line in (ROOT / "constraints.txt").read_text().splitlines() if not line.startswith("#")]
PINNED = {canonicalize_name(name): Version(pin) for name, _, pin in (line.partition("==") for line in LINES)}
MENDED = {"starlette": "1.3.1", "python-multipart": "0.0.34", "uvicorn": "0.51", "torch": "2.10", "pillow": "11.3"}
"""Versions in which advisories that concern a server were mended, such as those of ranges, hosts and multipart."""

OPTIONAL = ("tokenizers", "transformers")
"""What `tools/setup` leaves out; tests that need it are skipped without."""


def listed(manifest: Path) -> list[str]:
    """Returns all requirements of a distribution, those of its extras and of its development included."""
    file = tomllib.loads(manifest.read_text())
    groups = [*file["project"].get("optional-dependencies", {}).values(), *file.get("dependency-groups", {}).values()]
    return [*file["project"]["dependencies"], *(line for group in groups for line in group)]


def requirements() -> list[Requirement]:
    """Returns what the distributions need to run."""
    projects = [tomllib.loads(path.read_text())["project"] for path in MANIFESTS]
    lists = [[p["dependencies"], *p.get("optional-dependencies", {}).values()] for p in projects]
    found = {line for project in lists for group in project for line in group}
    return [each for each in map(Requirement, sorted(found)) if not each.name.startswith("freerein")]


@pytest.mark.parametrize("folder", [each.parent for each in MANIFESTS], ids=lambda each: each.name)
def test_a_distribution_comes_with_its_license(folder: Path) -> None:
    assert (folder / "LICENSE").read_bytes() == (ROOT / "LICENSE").read_bytes()


@pytest.mark.fault("D1")
@pytest.mark.parametrize("requirement", requirements(), ids=str)
def test_a_package_has_a_floor_and_a_pinned_version_that_is_installed(requirement: Requirement) -> None:
    floors = [Version(each.version) for each in requirement.specifier if each.operator == ">="]
    pin = PINNED[canonicalize_name(requirement.name)]
    assert len(floors) == 1
    assert requirement.specifier.contains(pin)
    if requirement.name not in OPTIONAL or requirement.name in DISTRIBUTIONS:
        assert Version(Version(version(requirement.name)).public) == pin
    assert floors[0] >= Version(MENDED.get(requirement.name, "0"))


@pytest.mark.fault("D1")
def test_setup_and_images_install_every_package_at_one_version() -> None:
    assert all(re.fullmatch(r"[A-Za-z0-9._-]+==[0-9][A-Za-z0-9.]*", line) for line in LINES)
    assert len(PINNED) == len(LINES)
    assert "constraints.txt" in (ROOT / "Dockerfile").read_text()
    assert "constraints.txt" in (ROOT / "tools" / "setup").read_text()


def test_no_image_holds_codecs_under_the_gpl() -> None:
    extras = re.findall(r"'\.\[([a-z,]+)\]'", (ROOT / "Dockerfile").read_text())
    assert extras
    assert "video" not in ",".join(extras).split(",")
    manifests = [tomllib.loads(path.read_text())["project"]["dependencies"] for path in MANIFESTS]
    assert not any("video" in Requirement(line).extras for lines in manifests for line in lines)


DISTRIBUTIONS = packages_distributions()
LISTED = {canonicalize_name(Requirement(line).name) for path in MANIFESTS for line in listed(path)}
PROGRAMS = ("tests", "experiments", "benchmarks", "soak", "mutants", "tools")


def imported(folder: str) -> set[str]:
    """Returns the packages that the files of a folder import by name, but for ours and Python's own."""
    found = set[str]()
    for path in (ROOT / folder).rglob("*.py"):
        if path.parent != ROOT / "tests/compat":  # runs beside LeRobot, in an environment of its own
            found.update(re.findall(r"^\s*(?:import|from) (\w+)", path.read_text(), re.MULTILINE))
    return {name for name in found if name in DISTRIBUTIONS and name not in sys.stdlib_module_names}


@pytest.mark.fault("D1")
@pytest.mark.parametrize("folder", PROGRAMS)
def test_what_a_program_imports_is_listed(folder: str) -> None:
    provided = {name: {canonicalize_name(each) for each in DISTRIBUTIONS[name]} for name in imported(folder)}
    assert {name for name, some in provided.items() if not some & LISTED} == set()
