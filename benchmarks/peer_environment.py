"""An environment of its own for policy servers of other projects, kept between runs; it sees our packages, too."""

import subprocess
import sys
import sysconfig
from pathlib import Path

_ALONE = ("vla-eval==0.8.0", "openpi-client==0.1.2")
"""Installed without what they need beyond serving and asking a policy, such as an encoder of videos."""

_WHOLE = ("litserve==0.2.19",)
_FOLDER = Path("var/peers-venv")


def peers_python() -> Path | None:
    """Returns the environment's Python, with the peers installed; None, and says so, where they cannot be."""
    ours = sysconfig.get_path("purelib")
    python, stamp, wanted = _FOLDER / "bin" / "python", _FOLDER / "installed", f"{_ALONE} {_WHOLE} {ours}"
    if stamp.is_file() and stamp.read_text() == wanted:
        return python.absolute()
    try:
        subprocess.run([sys.executable, "-m", "venv", "--clear", _FOLDER], check=True)
        (site,) = (_FOLDER / "lib").glob("python*/site-packages")
        (site / "ours.pth").write_text(f"import site; site.addsitedir({ours!r})\n")
        pip = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        subprocess.run([*pip, "--no-deps", *_ALONE], check=True)
        subprocess.run([*pip, *_WHOLE], check=True)
    except subprocess.CalledProcessError:
        names = ", ".join(_ALONE + _WHOLE)
        sys.stderr.write(f"peers: skipped. {names} could not be installed; is there a package index?\n")
        return None
    stamp.write_text(wanted)
    return python.absolute()
