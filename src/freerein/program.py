"""`python -m freerein.program MODULE ARGUMENTS` is `python -m MODULE ARGUMENTS` that starts sooner, and ends sooner.

To load torch and our modules makes many objects and no garbage; to look for it all the same takes a fifth of the
start. So the garbage collector is off until the module calls `loaded`.
"""

import gc
import os
import runpy
import sys
from contextlib import suppress
from typing import NoReturn


def main() -> None:
    """Runs the module that the first argument names."""
    run(sys.argv.pop(1))


def run(module: str) -> None:
    """Runs a module as the program."""
    gc.disable()
    runpy.run_module(module, run_name="__main__", alter_sys=True)


def loaded() -> None:
    """Turns the garbage collector on; what is loaded stays, and is not looked at again."""
    gc.freeze()
    gc.enable()


def end(code: int) -> NoReturn:
    """Ends the process at once: to free all that was loaded takes half a second, and a thread may hang.

    What a full disk does not take is lost; the exit code is not.
    """
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError):
            stream.flush()
    os._exit(code)


if __name__ == "__main__":
    main()
