"""Children of a fork server, each a real process."""

import json
import os
import resource
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from freerein.fork_server import ChildProcess, ForkServer, Program, spawn

SERVE = "import socket, sys; from freerein.fork_server import serve; serve(socket.socket(fileno=int(sys.argv[1])))"
CHILD = """
import json, os, sys
json.dump({"argv": sys.argv, "environ": dict(os.environ), "group": os.getpgid(0), "pid": os.getpid(),
           "parents": [os.getppid()], "fds": sorted(os.listdir("/proc/self/fd"))}, sys.stdout, default=str)
sys.stdout.flush()
read = sys.stdin.read()
if read == "raise":
    raise ValueError("as it was told to")
sys.exit(int(read or 0))
"""
REFUSED_FORKS = f"""
import errno, os, sys
answers, fork = os.open(sys.argv[2], os.O_RDONLY), os.fork
def fork_or_not():
    if os.read(answers, 1) == b"n":
        raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
    return fork()
os.fork = fork_or_not
{SERVE}
"""


class Children:
    """A fork server in a process of its own, and what it starts; `program` is that process, after `SERVE`."""

    def __init__(self, folder: Path, program: str = SERVE, *arguments: str) -> None:
        self._folder = folder
        (folder / "told_child.py").write_text(CHILD)
        self.ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        environ = {**os.environ, "PYTHONPATH": str(folder)}
        with theirs:
            command = [sys.executable, "-c", program, str(theirs.fileno()), *arguments]
            self.server = subprocess.Popen(command, pass_fds=[theirs.fileno()], env=environ)
        self.start = ForkServer(self.ours).start

    def run(self, start=None, *, keep=(), **environ: str) -> tuple[ChildProcess, int]:
        """Starts a child; returns it and its stdin."""
        stdin, told = os.pipe()
        environ = {"PYTHONPATH": str(self._folder), **environ}
        with os.fdopen(stdin), (self._folder / "out").open("wb") as out, (self._folder / "err").open("wb") as err:
            program = Program("told_child", ("a", "b c"), environ, stdin, out.fileno(), err.fileno(), keep)
            return (start or self.start)(program), told

    def said(self) -> dict[str, object]:
        return dict(json.loads((self._folder / "out").read_text()))


@pytest.fixture
def children(tmp_path: Path) -> Iterator[Children]:
    made = Children(tmp_path)
    yield made
    made.ours.close()
    made.server.wait(60)


@pytest.mark.parametrize("way", ["spawned", "forked"])
@pytest.mark.parametrize(("told", "code"), [(b"", 0), (b"143", 143), (b"raise", 1)])
def test_a_child_gets_its_arguments_and_environment_alone_and_ends_with_its_code(children, way, told, code, tmp_path):
    kept, other = os.pipe()
    child, stdin = children.run(spawn if way == "spawned" else None, keep=[kept], FREEREIN_MARK="x")
    os.write(stdin, told)
    os.close(stdin)
    assert (child.wait(60), child.poll()) == (code, code)
    said = children.said()
    assert said["argv"][1:] == ["a", "b c"]
    assert said["environ"]["FREEREIN_MARK"] == "x"
    assert "HOME" not in said["environ"]
    assert said["group"] == said["pid"] == child.pid
    assert len(said["fds"]) == 3 + 1 + 1  # the standard ones, what is kept, the listed folder
    assert ("ValueError: as it was told to" in (tmp_path / "err").read_text()) is (told == b"raise")
    os.close(kept)
    os.close(other)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGKILL])
def test_a_child_is_ended_by_a_signal_and_says_so(children, number, wait_until, tmp_path):
    child, stdin = children.run()
    wait_until((tmp_path / "out").read_text, 60)
    with pytest.raises(subprocess.TimeoutExpired):
        child.wait(0.01)
    assert child.poll() is None
    child.send_signal(number)
    assert child.wait(60) == -number
    child.send_signal(number)  # to nobody
    os.close(stdin)


def test_the_fork_server_survives_ctrl_c_and_ends_with_its_parent(children, wait_until):
    child, stdin = children.run()
    process = psutil.Process(children.server.pid)
    for number in (signal.SIGINT, signal.SIGTERM):
        process.send_signal(number)
    again, other = children.run()
    children.ours.close()
    assert children.server.wait(60) == 0
    for each, told in ((child, stdin), (again, other)):
        assert psutil.pid_exists(each.pid)  # ends by its own stdin
        os.close(told)
        assert each.wait(60) == 0


def test_where_the_fork_server_was_killed_a_child_is_spawned(children):
    children.server.kill()
    children.server.wait(60)
    child, stdin = children.run()
    os.close(stdin)
    assert child.wait(60) == 0
    assert isinstance(child, subprocess.Popen)


def test_where_a_fork_is_refused_that_child_is_spawned_and_the_next_one_forked_again(tmp_path):
    (tmp_path / "answers").write_text("n" + "yn" + "yy")  # to the fork server, and to its monitors
    children = Children(tmp_path, REFUSED_FORKS, str(tmp_path / "answers"))
    are_spawned = []
    for _ in range(3):
        child, stdin = children.run()
        os.close(stdin)
        assert child.wait(60) == 0
        are_spawned.append(isinstance(child, subprocess.Popen))
    children.ours.close()
    assert (children.server.wait(60), are_spawned) == (0, [True, True, False])


def test_where_descriptors_run_out_a_start_leaves_none_of_its_own_open():
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs:
        before = psutil.Process().num_fds()
        fillers = [os.dup(0) for _ in range(3)]  # each the lowest that is free
        resource.setrlimit(resource.RLIMIT_NOFILE, (fillers[-1] + 1, hard))
        try:
            for _ in range(2):
                os.close(fillers.pop())
            with pytest.raises(OSError, match="Too many open files"):
                ForkServer(ours).start(Program("told_child", (), {}, 0, 1, 2))
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
        os.close(fillers.pop())
        assert psutil.Process().num_fds() == before
