"""Services as real processes on free ports, for every test that speaks to one over a socket."""

import gc
import io
import json
import os
import re
import select
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import cache
from http.client import HTTPConnection
from pathlib import Path
from typing import TextIO

import hypothesis
import numpy as np
import numpy.typing as npt
import pytest
from tests import waiting

from freerein.fork_server import ChildProcess, ForkServer, Program, StartChild, spawn
from freerein.ports import Ports

_START_S = 300.0  # of a machine with much else to do
_ROOT = Path(__file__).parents[1]
hypothesis.settings.register_profile(
    "any machine",
    max_examples=20,
    deadline=None,
    suppress_health_check=[hypothesis.HealthCheck.too_slow, hypothesis.HealthCheck.function_scoped_fixture],
)
hypothesis.settings.load_profile("any machine")
os.environ.setdefault("OMP_NUM_THREADS", "1")  # before torch is imported: a second thread only fights the services


@dataclass(frozen=True)
class RunningService:
    """A service process.

    Attributes:
        process: The process.
        stdout: Its standard output, of which the first line was read.
        url: URL of its REST API, such as `http://127.0.0.1:12345`.
        address: Address of its gRPC server, such as `127.0.0.1:12346`.
        data_dir: Its data directory.
        log: Where its log goes.
    """

    process: ChildProcess
    stdout: io.BufferedReader
    url: str
    address: str
    data_dir: Path
    log: Path

    @property
    def http_port(self) -> int:
        return int(self.url.rpartition(":")[2])

    @property
    def grpc_port(self) -> int:
        return int(self.address.rpartition(":")[2])

    def get(self, path: str) -> tuple[int, str]:
        """Returns status and text of a GET over REST."""
        connection = HTTPConnection("127.0.0.1", self.http_port, timeout=60)  # httpx would load certificates each time
        with closing(connection):
            connection.request("GET", path)
            reply = connection.getresponse()
            return reply.status, reply.read().decode()

    def is_ready(self) -> bool:
        return self.get("/readyz")[0] == 200

    def until_ready(self) -> "RunningService":
        """Waits until it is ready; returns itself."""
        waiting.wait_until(self.is_ready, _START_S)
        return self

    def in_flight(self, protocol: str) -> float:
        """Returns the number of calls in progress over `rest`, of which this is one, or `grpc`."""
        name = rf'^freerein_calls_in_flight{{protocol="{protocol}"}} (\S+)$'
        found = re.search(name, self.get("/metrics")[1], re.MULTILINE)
        return float(found[1]) if found else 0.0

    def stop(self) -> int:
        """Sends SIGTERM; returns the exit code."""
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(60)

    def kill(self) -> None:
        self.process.send_signal(signal.SIGKILL)


StartService = Callable[..., RunningService]


_reserved: list[socket.socket] = []


def reserve_port() -> int:
    """Returns a port of loopback that no other process is given before a service binds it, or binds it again.

    It stays bound here: where all set SO_REUSEADDR, a port that nobody listens at can be bound twice.
    """
    _reserved.append(socket.socket())
    _reserved[-1].setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    _reserved[-1].bind(("127.0.0.1", 0))
    return int(_reserved[-1].getsockname()[1])


def pytest_configure(config: pytest.Config) -> None:
    """Collects no garbage until all tests are found: there is none. Test workers share one fork server."""
    gc.disable()
    if getattr(config.option, "numprocesses", None):
        _fork_server()


_LONGEST = (
    "orchestrator/test_ppo_run.py",
    "web/test_page.py",
    "orchestrator/test_evaluate_forms.py",
    "sim/test_worlds_conformance.py",
    "sim/test_worlds_golden.py",
    "orchestrator/test_dbos_queue.py",
    "faults/test_bodies.py",
)
"""Files that take a worker 20 s and more: they go first, so that none is left for one worker at the end."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Puts the longest files first."""
    first = {_ROOT / "tests" / name for name in _LONGEST}
    items.sort(key=lambda item: item.path not in first)


def pytest_collection_finish() -> None:
    """Collects garbage from here on."""
    gc.freeze()
    gc.enable()


def pytest_unconfigure() -> None:
    """Closes what reserved ports, and ends the fork server."""
    for reserving in _reserved:
        reserving.close()
    if _fork_server.cache_info().currsize:
        _fork_server().close()


_SERVICE_ENVIRON = {"OMP_NUM_THREADS": "1", "PYTHONWARNINGS": "error", "PYTHONPATH": str(_ROOT)}
_READ_BY_THE_INTERPRETER = ("LD_", "PYTHON", "MUJOCO_", "OMP_")
_WITH_PATH = """
import os, runpy, sys
sys.path[:0] = os.environ["PYTHONPATH"].split(os.pathsep)
sys.argv = sys.argv[1:]
runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
"""


def start_process(module: str, data_dir: Path, **environ: str) -> RunningService:
    """Starts `python -m module` and returns when it listens; it is forked unless its interpreter needs `environ`."""
    log = data_dir / f"{module}.{os.urandom(4).hex()}.log"
    data_dir.mkdir(parents=True, exist_ok=True)
    places = {"FREEREIN_HTTP_PORT": str(reserve_port()), "FREEREIN_GRPC_PORT": str(reserve_port())}
    settings = {**places, "FREEREIN_DATA_DIR": str(data_dir), **environ}
    unforked = any(name.startswith(_READ_BY_THE_INTERPRETER) and name != "PYTHONPATH" for name in environ)
    start = spawn if unforked else _fork_server().start
    forked = ("tests.code", (_WITH_PATH, module)) if "PYTHONPATH" in environ and not unforked else (module, ())
    output, stdout = (os.fdopen(fd, mode) for fd, mode in zip(os.pipe(), ("rb", "wb"), strict=True))
    with log.open("wb") as stderr, Path(os.devnull).open("rb") as stdin, stdout:
        whole = {**os.environ, **_SERVICE_ENVIRON, **settings}
        process = start(Program(*forked, whole, stdin.fileno(), stdout.fileno(), stderr.fileno()))
    readable, _, _ = select.select([output], [], [], _START_S)
    line = output.readline() if readable else b""
    if not line:
        process.send_signal(signal.SIGKILL)
        process.wait(60)
        output.close()
        pytest.fail(f"{module} did not start to listen:\n{log.read_text()[-3000:]}")
    ports = json.loads(line)
    url, address = f"http://127.0.0.1:{ports['http_port']}", f"127.0.0.1:{ports['grpc_port']}"
    return RunningService(process, output, url, address, data_dir, log)


_FORK_SERVER = "FREEREIN_TESTS_FORK_SERVER"
"""Variable of the environment that tells test workers the path of the fork server's socket."""


class _ServicesForkServer(ForkServer):
    """The fork server of all test workers, in a process that has imported all services."""

    def __init__(self) -> None:
        self._process = None if _FORK_SERVER in os.environ else _serve_forks()
        self._ours = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._ours.connect(os.environ[_FORK_SERVER])
        super().__init__(self._ours)

    def close(self) -> None:
        if self._process is not None:
            self._ours.send(b"\0")
            self._process.wait(60)
        self._ours.close()


def _serve_forks() -> "subprocess.Popen[bytes]":
    """Starts a process that will fork for whoever sends a request to the socket at `_FORK_SERVER`."""
    os.environ[_FORK_SERVER] = str(Path(tempfile.mkdtemp(), "fork-server"))
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as requests:
        requests.bind(os.environ[_FORK_SERVER])
        module = ("freerein.die_with_parent", str(os.getpid()), "tests.fork_services")
        command = [sys.executable, "-m", *module, str(requests.fileno())]
        return subprocess.Popen(command, env={**os.environ, **_SERVICE_ENVIRON}, pass_fds=[requests.fileno()])


_fork_server = cache(_ServicesForkServer)


def _run_to_end(module: str, arguments: Sequence[str], environ: Mapping[str, str]) -> tuple[int, str]:
    """Runs `python -m module`, forked, with a standard input that stays open; returns exit code and standard error."""
    stdin, held = (os.fdopen(fd, mode) for fd, mode in zip(os.pipe(), ("rb", "wb"), strict=True))
    with stdin, held, tempfile.TemporaryFile() as stderr, Path(os.devnull).open("wb") as stdout:
        whole = {**os.environ, **_SERVICE_ENVIRON, **environ}
        program = Program(module, arguments, whole, stdin.fileno(), stdout.fileno(), stderr.fileno())
        code = _fork_server().start(program).wait(_START_S)
        stderr.seek(0)
        return code, stderr.read().decode()


@pytest.fixture(scope="session")
def run_badly() -> Callable[..., tuple[int, str]]:
    """A function that runs a service that should not start, and returns its exit code and its standard error."""

    def run(module: str, data_dir: Path, **environ: str) -> tuple[int, str]:
        ports = {"FREEREIN_HTTP_PORT": "0", "FREEREIN_GRPC_PORT": "0", "FREEREIN_DATA_DIR": str(data_dir)}
        return _run_to_end(module, (), {**ports, **environ})

    return run


@pytest.fixture(scope="session")
def run_child() -> Callable[..., tuple[int, str]]:
    """A function that runs the child process of a job, such as `run_child("freerein_reward.fit_child", FOLDER, ...)`.

    It returns its exit code and its standard error.
    """
    return lambda module, *arguments: _run_to_end(module, [str(each) for each in arguments], {})


@pytest.fixture(scope="session")
def fork_child() -> StartChild:
    """A function that starts a child process which has imported all services."""
    return lambda program: _fork_server().start(program)


@dataclass(frozen=True)
class PipedProgram:
    """A process whose standard input and output are pipes.

    Attributes:
        process: The process.
        stdin: Where its input is written.
        stdout: Where its output is read.
    """

    process: ChildProcess
    stdin: TextIO
    stdout: TextIO


@pytest.fixture
def fork_program(fork_child: StartChild) -> Iterator[Callable[..., PipedProgram]]:
    """A function that forks `python -m MODULE ARGUMENTS`, ended with the test: `fork_program("tests.code", CODE)`."""
    started: list[PipedProgram] = []

    def start(module: str, *arguments: object) -> PipedProgram:
        (stdin, ours), (theirs, stdout) = os.pipe(), os.pipe()
        with os.fdopen(stdin), os.fdopen(stdout, "w"):
            whole = {**os.environ, **_SERVICE_ENVIRON}
            process = fork_child(Program(module, [str(each) for each in arguments], whole, stdin, stdout, 2))
        started.append(PipedProgram(process, os.fdopen(ours, "w"), os.fdopen(theirs)))
        return started[-1]

    yield start
    for program in started:
        program.process.send_signal(signal.SIGKILL)
        program.process.wait(60)
        program.stdin.close()
        program.stdout.close()


@pytest.fixture(scope="session")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The PEM files of a private key and of a certificate for `localhost` and loopback, made with it."""
    folder = tmp_path_factory.mktemp("tls")
    key, chain = folder / "key.pem", folder / "cert.pem"
    command = "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 1 -subj /CN=localhost"
    names = ["-addext", "subjectAltName=DNS:localhost,IP:127.0.0.1"]
    subprocess.run([*command.split(), *names, "-keyout", key, "-out", chain], check=True, capture_output=True)
    return key, chain


@pytest.fixture(scope="session")
def encode_video() -> Callable[..., bytes]:
    """A function that returns frames, uint8 (T, H, W, 3), as a video file."""

    def encode(
        frames: npt.NDArray[np.uint8], *, codec: str = "libx264", container: str = "mp4", fps: int = 10
    ) -> bytes:
        import av

        file = io.BytesIO()
        with av.open(file, "w", format=container) as muxer:
            stream = muxer.add_stream(codec, rate=fps)
            stream.height, stream.width = frames.shape[1:3]
            stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
            if codec == "libsvtav1":  # with more threads it has come to a deadlock
                stream.options = {"svtav1-params": "lp=1"}
            for pixels in frames:
                muxer.mux(stream.encode(av.VideoFrame.from_ndarray(pixels, format="rgb24")))
            muxer.mux(stream.encode())
        return file.getvalue()

    return encode


@pytest.fixture(scope="session")
def reserve_ports() -> Callable[[Iterable[str]], dict[str, Ports]]:
    """A function like `free_ports`, whose ports no other process is given."""
    return lambda names: {name: Ports(reserve_port(), reserve_port()) for name in names}


@pytest.fixture(scope="session")
def wait_until() -> Callable[[Callable[[], object], float], float]:
    """A function that waits until a condition holds, `within_s` seconds at most; it returns how long that took."""
    return waiting.wait_until


@pytest.fixture(scope="session", autouse=True)
def _logs_of_stable_baselines3(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Its logger makes a folder for every training, by default in the system's temporary folder."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SB3_LOGDIR", str(tmp_path_factory.mktemp("stable_baselines3")))
        yield


@pytest.fixture(autouse=True)
def _keep_small_numbers() -> Iterator[None]:
    """Trainings flush denormal numbers to zero for their whole process; the next test wants them back."""
    yield
    if "torch" in sys.modules:
        sys.modules["torch"].set_flush_denormal(False)


@pytest.fixture
def start_service(tmp_path: Path) -> Iterator[StartService]:
    """A function that starts a service process, ended with the test: `start_service("freerein_sim", NAME="value")`."""
    started: list[RunningService] = []

    def start(module: str, data_dir: Path | None = None, **environ: str) -> RunningService:
        started.append(start_process(module, data_dir or tmp_path / "data", **environ))
        return started[-1]

    yield start
    _end_all(started)


@pytest.fixture(scope="module")
def start_module_service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[StartService]:
    """As `start_service`, for services that a whole module shares."""
    started: list[RunningService] = []

    def start(module: str, data_dir: Path | None = None, **environ: str) -> RunningService:
        started.append(start_process(module, data_dir or tmp_path_factory.mktemp("data"), **environ))
        return started[-1]

    yield start
    _end_all(started)


def _end_all(started: list[RunningService]) -> None:
    for service in started:
        service.kill()
        service.process.wait(60)
        service.stdout.close()
