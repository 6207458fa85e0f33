"""How programs end."""

import subprocess
import sys

import pytest

_SAYS_SOMETHING_AND_ENDS = """
import sys
from freerein import program
sys.stdout, sys.stderr = (open("/dev/full", "w") for _ in range(2))
sys.stdout.write("what nobody can read")
sys.stderr.write("nor this")
program.end(74)
"""


@pytest.mark.fault("F9")
def test_a_program_whose_output_is_on_a_full_disk_keeps_its_exit_code() -> None:
    ended = subprocess.run([sys.executable, "-c", _SAYS_SOMETHING_AND_ENDS], check=False)
    assert ended.returncode == 74
