"""A user's command or Python block, forked from the process that services are forked from.

python -S forked.py freerein ARGUMENTS     as `freerein ARGUMENTS`
python -S forked.py python BLOCK           as `python -c BLOCK`

As the main module of the fork (`tests.e2e.forked FOLDER ...`), it runs that in a folder.
"""

import os
import socket
import sys
import traceback
from pathlib import Path

ROOT = Path(__file__).parents[2]


def ask() -> int:
    """Has the fork server run what the arguments say, with this process's files; returns the exit code."""
    sys.path.insert(0, str(ROOT / "src"))
    from freerein.fork_server import ForkServer, Program

    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as requests:
        requests.connect(os.environ["FREEREIN_TESTS_FORK_SERVER"])
        program = Program("tests.e2e.forked", (str(Path.cwd()), *sys.argv[1:]), os.environ, 0, 1, 2)
        return ForkServer(requests).start(program).wait()


def run(folder: str, program: str, *arguments: str) -> int:
    """Runs a command or block in a folder; returns the exit code."""
    os.chdir(folder)
    sys.argv = [program, *arguments]
    try:
        if program == "python":
            exec(arguments[0], {"__name__": "__main__"})
        else:
            from freerein.cli.__main__ import main

            main()
    except SystemExit as ended:
        return int(ended.code or 0)
    except Exception:
        traceback.print_exc()
        return 1
    return 0


if __name__ == "__main__":
    if __package__:
        from freerein.program import end

        end(run(*sys.argv[1:]))
    sys.exit(ask() & 0xFF)
