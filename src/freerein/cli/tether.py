"""`python -m freerein.cli.tether PARENT MODULE`: as `python -m MODULE`, but it never outlives its parent process.

The kernel is told to kill this process when its parent ends, however that ends; a hung service dies too, and nobody has
to watch a pipe. The process tells the kernel itself, before the service is loaded: a `preexec_fn` would run Python in
the fork of a process that has threads, which can deadlock. Nothing is lost by a kill: what services write is durable.
"""

import ctypes
import os
import runpy
import signal
import sys

_PR_SET_PDEATHSIG = 1


def main() -> None:
    """Ties this process to its parent, then becomes the service."""
    parent, module = int(sys.argv[1]), sys.argv[2]
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        sys.exit(1)  # it ended before the kernel was told
    sys.argv[1:] = []
    runpy.run_module(module, run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
