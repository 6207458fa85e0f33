"""The template of a world of one's own, installed as its README says, but without pip."""

import shutil
import tomllib
from pathlib import Path

TEMPLATE = Path("examples/own_world")


def install_template(folder: Path) -> None:
    """Installs the template, with its metadata, in an existing folder that is to be on the path of imports."""
    project = tomllib.loads((TEMPLATE / "pyproject.toml").read_text())["project"]
    shutil.copy(TEMPLATE / "own_world.py", folder)
    info = folder / "own_world-1.0.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n")
    worlds = project["entry-points"]["freerein.worlds"]
    (info / "entry_points.txt").write_text(
        "\n".join(["[freerein.worlds]", *(f"{name} = {place}" for name, place in worlds.items())])
    )
