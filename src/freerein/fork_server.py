"""Child processes that are forked, and so have imported from the start what their parent has imported.

To import torch and our modules takes each fit and each run one to three seconds. A fork of a process with threads would
copy the locks that they hold; so a service forks a fork server before its first thread begins, and later asks it:

    service --request--> fork server --fork--> monitor --fork--> child
       ^                                          |
       +------------ pid, then exit code ---------+

The fork server ends with the service, and a monitor with its child.
"""

import gc
import json
import os
import runpy
import select
import signal
import socket
import struct
import subprocess
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import NoReturn, Protocol, TypeAlias

_NUMBER = struct.Struct("i")
_MOST_FDS = 16


class ChildProcess(Protocol):
    """A child process, such as `subprocess.Popen` is one."""

    @property
    def pid(self) -> int:
        """Its process id."""

    def poll(self) -> int | None:
        """Returns its exit code, -N where signal N ended it; None while it runs."""

    def wait(self, timeout: float | None = None) -> int:
        """Returns its exit code, as of `poll`, once it has ended. Raises `subprocess.TimeoutExpired`."""

    def send_signal(self, sig: int) -> None:
        """Sends a signal, unless it is known to have ended."""


@dataclass(frozen=True)
class Program:
    """A child process to start: `python -m freerein.program MODULE ARGUMENTS`, in a process group of its own.

    Attributes:
        module: The module.
        arguments: Its arguments.
        environ: Its whole environment.
        stdin: Its standard input, a file descriptor; so are `stdout` and `stderr`.
        stdout: Its standard output.
        stderr: Its standard error.
        keep: File descriptors that it holds open, too.
    """

    module: str
    arguments: Sequence[str]
    environ: Mapping[str, str]
    stdin: int
    stdout: int
    stderr: int
    keep: Sequence[int] = ()


StartChild: TypeAlias = Callable[[Program], ChildProcess]
"""Starts a child process; raises OSError where the system refuses it."""


def spawn(program: Program) -> ChildProcess:
    """Starts a child process in a new interpreter."""
    return subprocess.Popen(
        [sys.executable, "-m", "freerein.program", program.module, *program.arguments],
        env=program.environ,
        stdin=program.stdin,
        stdout=program.stdout,
        stderr=program.stderr,
        pass_fds=program.keep,
        process_group=0,
    )


class ForkServer:
    """A fork server, as the process that asks it sees it.

    Args:
        requests: A socket that keeps messages apart, and passes descriptors; `serve` runs at its other end.
    """

    def __init__(self, requests: socket.socket) -> None:
        self._requests = requests

    @classmethod
    def fork(cls, *late_imports: str) -> "ForkServer":
        """Forks a fork server from this process, whose only threads are those of imports that survive a fork.

        Args:
            late_imports: Modules that children need and this process does not; imported before the first child.

        Raises:
            SystemExit: In a child process, when its module ends.
        """
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        gc.freeze()  # the collector would write to every page, which then is no longer shared
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of Python 3.12: OpenBLAS and jemalloc have threads
            pid = os.fork()
        if pid == 0:
            ours.close()
            serve(theirs, *late_imports)
        theirs.close()
        return cls(ours)

    def start(self, program: Program) -> ChildProcess:
        """Starts a child process by a fork; by `spawn` where the fork server was killed, or could not fork it."""
        with os.fdopen(os.memfd_create("program"), "w+b") as request:
            request.write(json.dumps([program.module, list(program.arguments), dict(program.environ)]).encode())
            request.flush()
            status, status_of_child = os.pipe()
            with os.fdopen(status_of_child):
                fds = [request.fileno(), status_of_child, program.stdin, program.stdout, program.stderr, *program.keep]
                with suppress(OSError):  # where nobody is left, nobody writes to `status`
                    socket.send_fds(self._requests, [b"\0"], fds)
        if pid := os.read(status, _NUMBER.size):
            return _Forked(_NUMBER.unpack(pid)[0], status)
        os.close(status)
        return spawn(program)


class _Forked:
    """A forked child, whose exit code its monitor will write to the pipe `status`."""

    def __init__(self, pid: int, status: int) -> None:
        self.pid = pid
        self._status = os.fdopen(status, "rb", buffering=0)
        self._ended = select.poll()  # `select.select` knows no descriptors from 1024 on
        self._ended.register(status, select.POLLIN)
        self._code: int | None = None

    def poll(self) -> int | None:
        with suppress(subprocess.TimeoutExpired):
            return self.wait(0)
        return None

    def wait(self, timeout: float | None = None) -> int:
        if self._code is None:
            if not self._ended.poll(None if timeout is None else timeout * 1000):
                raise subprocess.TimeoutExpired("a forked child", timeout or 0)
            code = self._status.read(_NUMBER.size)
            self._code = _NUMBER.unpack(code)[0] if code else -signal.SIGKILL  # the monitor was killed, too
            self._status.close()
        return self._code

    def send_signal(self, sig: int) -> None:
        if self.poll() is None:
            with suppress(ProcessLookupError):
                os.kill(self.pid, sig)


def serve(requests: socket.socket, *late_imports: str) -> NoReturn:
    """Is the fork server, until a message without descriptors, as a closed socket gives; see `ForkServer.fork`.

    Raises:
        SystemExit: In a child process, when its module ends.
    """
    _name_process("fork server")
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # such as Ctrl-C, which is for the service
    signal.signal(signal.SIGCHLD, _reap)
    while fds := socket.recv_fds(requests, 1, _MOST_FDS)[1]:
        for module in late_imports:
            import_module(module)
        if _fork() == 0:
            requests.close()
            _monitor(*fds)
        for fd in fds:
            os.close(fd)
    os._exit(0)


def _fork() -> int | None:
    """Forks as `os.fork`; returns None where the system refuses it, as for want of memory or of process ids."""
    try:
        return os.fork()
    except OSError:
        return None


def _name_process(name: str) -> None:
    """Sets what `ps` and `top` call this process, up to 15 characters; it was forked with the name of its parent."""
    Path("/proc/self/comm").write_text(name)


def _reap(*_: object) -> None:
    """Waits for the monitors that have ended."""
    with suppress(ChildProcessError):
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass


def _monitor(request: int, status: int, *fds: int) -> NoReturn:
    """Forks a child, and reports its process id and its exit code; nothing where the fork is refused."""
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    pid = _fork()
    if pid is None:
        os._exit(1)
    if pid == 0:
        os.close(status)
        _run(request, *fds)
    for fd in (request, *fds):
        os.close(fd)
    os.write(status, _NUMBER.pack(pid))
    code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    with suppress(BrokenPipeError):  # the service has ended
        os.write(status, _NUMBER.pack(code))
    os._exit(0)


def _run(request: int, stdin: int, stdout: int, stderr: int, *_keep: int) -> NoReturn:
    """Is the child: runs the module that a request asks for."""
    os.setpgid(0, 0)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    for number, fd in enumerate((stdin, stdout, stderr)):
        os.dup2(fd, number)
        os.close(fd)
    with os.fdopen(request, "rb") as file:
        file.seek(0)
        module, arguments, environ = json.load(file)
    _name_process(module.removeprefix("freerein_"))
    os.environ.clear()
    os.environ.update(environ)
    sys.argv = [module, *arguments]
    runpy.run_module(module, run_name="__main__", alter_sys=True)
    raise SystemExit
