"""What `tools/setup` asks the system for, with an apt-get that only fails, and libraries that no loader opens."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PYTHON = f"""#!/bin/sh
[ "$1" = -m ] && exit 7
exec {sys.executable} "$@"
"""


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A tree with tools/setup, and programs that it must not really run."""
    projects = ("pyproject.toml", "src/pyproject.toml", "services/sim/pyproject.toml")
    for name in ("tools/setup", "constraints.txt", "assets.txt", "assets-robots.txt", "assets-doom.txt", *projects):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    (tmp_path / "bin").mkdir()
    (tmp_path / "lib").mkdir()
    for name, script in (("apt-get", "#!/bin/sh\nexit 8"), ("sudo", "#!/bin/sh\nexit 9"), ("python", PYTHON)):
        (tmp_path / "bin" / name).write_text(script)
        (tmp_path / "bin" / name).chmod(0o755)
    return tmp_path


def asked_for(tree: Path, kind: str, *, missing: tuple[str, ...]) -> set[str]:
    """Returns the packages of the system that it installs, or asks the user to install."""
    for name in missing:
        for version in ("", *(f".{i}" for i in range(10))):
            (tree / "lib" / f"lib{name}.so{version}").touch()
    ended = subprocess.run(
        [tree / "tools" / "setup", kind],
        env={
            "PATH": f"{tree / 'bin'}:{os.environ['PATH']}",
            "PYTHON": str(tree / "bin" / "python"),
            "LD_LIBRARY_PATH": str(tree / "lib"),
        },
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode in (1, 7, 8), ended.stderr
    return {word for word in ended.stderr.split() if word.startswith("lib")}


@pytest.mark.parametrize(
    ("kind", "missing", "expected"),
    [
        ("dev", (), set()),
        ("dev", ("OSMesa",), {"libosmesa6"}),
        ("dev", ("EGL", "OSMesa"), {"libegl1", "libgl1", "libosmesa6"}),
        ("run", ("EGL",), set()),
        ("run", ("EGL", "OSMesa"), {"libegl1", "libgl1"}),
    ],
)
def test_tests_need_both_ways_to_render_and_the_services_one(
    tree: Path, kind: str, missing: tuple[str, ...], expected: set[str]
) -> None:
    assert asked_for(tree, kind, missing=missing) == expected


def test_a_python_that_is_named_and_unsupported_is_not_replaced_by_another(tree: Path) -> None:
    python = shutil.which("false")
    ended = subprocess.run(
        [tree / "tools" / "setup"],
        env={**os.environ, "PYTHON": str(python)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 1
    assert f"was not found; tried: {python}." in ended.stderr
