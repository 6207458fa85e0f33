"""A worker process, `python -m freerein_sim.workers`, whose standard input is a socket. The service starts it."""

import logging
import os
import signal
import socket
import sys

from freerein import program
from freerein.serving import logs
from freerein_sim.workers.handler import RequestHandler, serve
from freerein_sim.worlds.tasks import tasks


def main() -> None:
    """Serves the socket until the service closes it or dies."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal signals the whole group; the service stops its workers
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    logs.configure("sim")
    logging.getLogger().setLevel(logging.WARNING)
    handler = RequestHandler(tasks())
    program.loaded()
    with socket.socket(fileno=os.dup(sys.stdin.fileno())) as connection:
        serve(connection, handler)
    handler.close()


if __name__ == "__main__":
    main()
