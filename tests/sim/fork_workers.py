"""A fork server of worker processes: `python -m tests.sim.fork_workers FD`, with a socket that receives requests."""

import os
import socket
import sys
from importlib import import_module

from freerein.fork_server import serve
from freerein_sim.worlds.tasks import tasks

if __name__ == "__main__":
    requests = socket.socket(fileno=int(sys.argv[1]))
    os.set_inheritable(requests.fileno(), False)
    import_module("freerein_sim.workers.__main__")
    del sys.modules["freerein_sim.workers.__main__"]  # what it imports stays; it runs as `__main__`
    tasks()
    serve(requests)
