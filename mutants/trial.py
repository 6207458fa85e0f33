"""Whether the tests of a file notice a change in it, in a copy of the repository."""

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from enum import StrEnum
from pathlib import Path

from mutants.edits import Edit

_FAILED, _BROKEN = 1, 2
"""Exit codes of pytest: a test failed, or could not be imported."""


class Outcome(StrEnum):
    """The outcome of a trial."""

    KILLED = "killed"
    TIMED_OUT = "timed out"
    SURVIVED = "survived"


class Copy:
    """A copy of the repository whose tests import its own sources, and so do the processes that they start.

    Args:
        repository: What is copied: the files that git knows or does not ignore.
        folder: Where to; must not exist.
    """

    def __init__(self, repository: Path, folder: Path) -> None:
        self.folder = folder
        listed = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
        for name in subprocess.check_output(listed, cwd=repository, text=True).split("\0"):
            if (repository / name).is_file():
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(repository / name, folder / name)
        sources = [folder / "src", *sorted((folder / "services").iterdir())]
        self._environ = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, sources)), "PYTHONDONTWRITEBYTECODE": "1"}

    def test(self, tests: Sequence[str], *, timeout_s: float) -> Outcome:
        """Runs tests until the first fails.

        Raises:
            RuntimeError: pytest could not run them, such as for a test file that does not exist.
        """
        command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *tests]
        nowhere = subprocess.DEVNULL
        process = subprocess.Popen(
            command, cwd=self.folder, env=self._environ, stdout=nowhere, stderr=nowhere, start_new_session=True
        )
        try:
            code = process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            return Outcome.TIMED_OUT
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)  # pytest after a timeout, and services that it left behind
            process.wait()
        if code not in (0, _FAILED, _BROKEN):
            raise RuntimeError(f"pytest {' '.join(tests)} ended with exit code {code}.")
        return Outcome.KILLED if code else Outcome.SURVIVED

    def try_edit(self, path: str, edit: Edit, tests: Sequence[str], *, timeout_s: float) -> Outcome:
        """Changes a file, runs its tests, and changes it back."""
        file = self.folder / path
        source = file.read_bytes()
        file.write_bytes(edit.apply(source))
        try:
            return self.test(tests, timeout_s=timeout_s)
        finally:
            file.write_bytes(source)
