"""`python -m freerein.die_with_parent PARENT MODULE`: `python -m MODULE` that dies with its parent.

Sets the kernel's parent death signal to SIGKILL before anything is loaded. A `preexec_fn` instead would run Python in
the fork of a process with threads, which can deadlock. A kill loses nothing: services write durably.
"""

import ctypes
import os
import signal
import sys

from freerein import program

_PR_SET_PDEATHSIG = 1


def main() -> None:
    """Sets the parent death signal, then runs the module."""
    parent = int(sys.argv.pop(1))
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        sys.exit(1)  # the parent ended before the signal was set
    program.main()


if __name__ == "__main__":
    main()
