"""`python -m freerein.cli.services.die_with_parent PARENT MODULE`: `python -m MODULE` that dies with its parent.

Sets the kernel's parent death signal to SIGKILL before the module is loaded. A `preexec_fn` instead would run Python in
the fork of a process with threads, which can deadlock. A kill loses nothing: services write durably.
"""

import ctypes
import os
import runpy
import signal
import sys

_PR_SET_PDEATHSIG = 1


def main() -> None:
    """Sets the parent death signal, then runs the module."""
    parent, module = int(sys.argv[1]), sys.argv[2]
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        sys.exit(1)  # the parent ended before the signal was set
    sys.argv[1:] = []
    runpy.run_module(module, run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
