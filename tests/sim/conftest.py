"""What tests of worlds and of worker processes share."""

import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing

import numpy as np
import pytest
from tests.engine import skip_without_engine

from freerein.fork_server import ForkServer, StartChild
from freerein_sim.worlds.varied_world import build
from freerein_sim.worlds.world import TaskDefinition

KeepOpen = Callable[..., None]


@pytest.fixture(scope="session")
def keep_open() -> Iterator[KeepOpen]:
    """A function that keeps a world of a task open until the session ends, under conditions or none.

    Worlds of one scene share its OpenGL context, which takes up to 0.4 s of CPU time to make. Skips where the world's
    engine is not installed.
    """
    with ExitStack() as opened:
        kept: set[tuple[str, ...]] = set()

        def keep(task: TaskDefinition, *conditions: str) -> None:
            skip_without_engine(task)
            if (task.name, *conditions) not in kept:
                kept.add((task.name, *conditions))
                world, camera = opened.enter_context(closing(build(task, conditions))), task.spec.cameras[0]
                world.reset(np.random.default_rng(0))
                world.render(camera.name, height=camera.height, width=camera.width)

        yield keep


@pytest.fixture(scope="session")
def fork_worker() -> Iterator[StartChild]:
    """A function that starts worker processes as the service does, by a fork; they descend from this process."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with theirs:
        command = [sys.executable, "-m", "tests.sim.fork_workers", str(theirs.fileno())]
        server = subprocess.Popen(command, pass_fds=[theirs.fileno()])
    yield ForkServer(ours).start
    ours.close()
    server.wait(60)
