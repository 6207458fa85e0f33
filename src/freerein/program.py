"""`python -m freerein.program MODULE ARGUMENTS` is `python -m MODULE ARGUMENTS` that starts sooner.

To load torch and our modules makes many objects and no garbage; to look for it all the same takes a fifth of the
start. So the garbage collector is off until the module calls `loaded`.
"""

import gc
import runpy
import sys


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


if __name__ == "__main__":
    main()
