"""`freerein-client`, of src/pyproject.toml, has what its modules import, in every version that it allows."""

import ast
import re
import sys
import tomllib
from pathlib import Path

from packaging.requirements import Requirement
from packaging.version import Version

ROOT = Path(__file__).parents[2]
CLIENT = tomllib.loads((ROOT / "src" / "pyproject.toml").read_text())
LIBRARY = tomllib.loads((ROOT / "pyproject.toml").read_text())
INCLUDED = [ROOT / "src" / path for path in CLIENT["tool"]["hatch"]["build"]["only-include"]]
MODULES = [path for each in INCLUDED for path in (sorted(each.rglob("*.py")) if each.is_dir() else [each])]
REQUIREMENTS = [Requirement(line) for line in CLIENT["project"]["dependencies"]]
FLOORS = {each.name: s.version for each in REQUIREMENTS for s in each.specifier if s.operator == ">="}
IMPORTED_AS = {
    "googleapis-common-protos": "google",
    "grpcio": "grpc",
    "numpy": "numpy",
    "pillow": "PIL",
    "protobuf": "google",
    "typing-extensions": "typing_extensions",
}
NEWER_MODULES = {"tomllib"}
NEWER_NAMES = {
    "assert_never",
    "ExceptionGroup",
    "LiteralString",
    "Never",
    "NotRequired",
    "override",
    "Self",
    "StrEnum",
    "UTC",
}
"""What Python 3.10 lacks; not a whole list."""


def imports(path: Path) -> list[tuple[str, str]]:
    """Returns what a module imports: modules, and the name from it or an empty one."""
    found = []
    for node in ast.walk(ast.parse(path.read_text(), feature_version=(3, 10))):
        if isinstance(node, ast.Import):
            found += [(each.name, "") for each in node.names]
        elif isinstance(node, ast.ImportFrom):
            found += [(node.module or "", each.name) for each in node.names]
    return found


def is_included(module: str, name: str) -> bool:
    """Returns whether a module of the library, or the module `name` in a package, is in the distribution."""
    candidates = [ROOT / "src" / each.replace(".", "/") for each in (f"{module}.{name}", module)]
    file = next(
        each for path in candidates for each in (path.with_suffix(".py"), path / "__init__.py", path) if each.exists()
    )
    return file in MODULES


def test_every_file_of_the_library_is_in_one_of_two_distributions() -> None:
    excluded = LIBRARY["tool"]["hatch"]["build"]["targets"]["wheel"]["exclude"]
    assert [ROOT / path for path in excluded] == INCLUDED
    assert all(path.exists() for path in INCLUDED)
    version = CLIENT["project"]["version"]
    assert f"freerein-client=={version}" in LIBRARY["project"]["dependencies"]


def test_the_clients_import_only_what_their_distribution_has() -> None:
    assert set(FLOORS) == set(IMPORTED_AS)
    for path, module, name in ((each, *imported) for each in MODULES for imported in imports(each)):
        package = module.partition(".")[0]
        if package == "freerein":
            assert is_included(module, name), (path, module)
        elif package in sys.stdlib_module_names:
            assert package not in NEWER_MODULES, path
            assert name not in NEWER_NAMES, path
        else:
            assert package in IMPORTED_AS.values(), path


def test_the_stubs_are_no_newer_than_the_oldest_packages_that_they_may_meet() -> None:
    stubs = "\n".join(path.read_text() for path in MODULES if path.stem.endswith(("_pb2", "_pb2_grpc")))
    for pattern, package in (
        (r"Protobuf Python Version: (\S+)", "protobuf"),
        (r"GENERATED_VERSION = '(.+)'", "grpcio"),
    ):
        generated = {Version(each) for each in re.findall(pattern, stubs)}
        assert len(generated) == 1
        assert max(generated) <= Version(FLOORS[package])
