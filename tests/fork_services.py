"""The fork server of the tests: services that it starts have imported all they need.

python -m tests.fork_services FD     with a socket that receives requests
"""

import gc
import importlib
import os
import socket
import sys

import av  # noqa: F401  # for the videos of policies that runs make

from freerein.fork_server import serve
from freerein.learning.optimiser import IMPORTED_BY_OPTIMISERS
from freerein.program import end

_MODULES = (
    "freerein_orchestrator.__main__",
    "freerein_orchestrator.runs.__main__",
    *(
        f"freerein_{service}.{module}"
        for service in ("segmentation", "imitation", "reward")
        for module in ("__main__", "fit_child")
    ),
    "freerein_sim.__main__",
)

if __name__ == "__main__":
    gc.disable()
    requests = socket.socket(fileno=int(sys.argv[1]))
    os.set_inheritable(requests.fileno(), False)
    for module in _MODULES:
        importlib.import_module(module)
        del sys.modules[module]  # what it imports stays; it runs as `__main__`
    gc.freeze()
    gc.enable()
    try:
        serve(requests, IMPORTED_BY_OPTIMISERS)
    except SystemExit as ended:  # in a child: to free all imports takes half a second of CPU
        end(int(ended.code or 0))
