"""What the fault rows share: the faulty service, ways to speak to it badly, and what no answer may ever hold."""

import base64
import os
import re
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import httpx
import numpy as np
import psutil
import pytest

FAULTS = ("right", "raises", "nan", "shape", "infinite", "hangs", "held")
FUZZ = os.environ.get("FREEREIN_FUZZ") == "1"
_LEAKS = re.compile(r"0x[0-9a-f]{6,}|Traceback|site-packages|\.py\b|object at|/(root|home|tmp|usr|work|var)/")
_BUGS = (
    '"event": "bug"',
    "Traceback",
    "RecursionError",
    "never retrieved",
    "Exception ignored",
    "ResourceWarning",
    "was destroyed",
)


@dataclass(frozen=True)
class Faulty:
    """The faulty service as a process, and how to speak to it.

    Attributes:
        service: The process.
        http: HTTP client of its REST API.
        token: The token that it asks for.
    """

    service: Any
    http: httpx.Client
    token: str = ""

    @property
    def process(self) -> psutil.Process:
        return psutil.Process(self.service.process.pid)

    @property
    def jobs(self) -> list[psutil.Process]:
        """The child processes of its fits and runs that have not ended."""
        return [each for each in self.process.children(recursive=True) if _is_job(each)]

    def trajectory(self, brightness: Sequence[int] = (0, 1), *, fault: str = "right", hundredths: int = 0) -> Any:
        """Returns a request, of one timestep for each brightness, that asks for a fault or for time."""
        frames = np.zeros((len(brightness), 4, 4, 3), np.uint8)
        frames[:, 0, 0, 2] = brightness
        frames[:1, 0, 0, :2] = FAULTS.index(fault), hundredths
        return {"frames": tensor(frames)}

    def segment(self, *brightness: int, **asked: Any) -> httpx.Response:
        return self.http.post("/v1/segment", json=self.trajectory(brightness or (0, 1), **asked))

    def cpu_s(self) -> float:
        """Returns the CPU seconds that it has taken, which do not grow with what else the machine does."""
        return sum(self.process.cpu_times()[:2])

    def metric(self, name: str) -> float:
        """Returns a metric's value, 0 where it was never counted."""
        found = re.search(rf"^{re.escape(name)} (\S+)$", self.http.get("/metrics").text, re.MULTILINE)
        return float(found[1]) if found else 0.0

    def hold(self) -> IO[bytes]:
        """Returns when the model is in a call that asks to be held; it is held until what is returned is closed."""
        begun = time.monotonic()
        while True:
            try:
                return os.fdopen(os.open(self.service.data_dir / "gate", os.O_WRONLY | os.O_NONBLOCK), "wb")
            except OSError:  # nobody reads it
                assert time.monotonic() - begun < 60, "the model did not begin"
                time.sleep(0.005)

    def connect(self, timeout_s: float = 60.0) -> socket.socket:
        return socket.create_connection(("127.0.0.1", self.service.http_port), timeout_s)

    def raw(self, data: bytes, *, timeout_s: float = 60.0) -> bytes:
        """Returns what comes back for bytes until the connection is closed by the other side."""
        with self.connect(timeout_s) as connection:
            return exchange(connection, data)


def _is_job(process: psutil.Process) -> bool:
    names = {name[:15] for name in ("segmentation.fit", "orchestrator.runs")}  # as /proc tells them
    try:
        return process.name() in names and process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def tensor(array: "np.ndarray[Any, Any]") -> dict[str, Any]:
    names = {"uint8": "UINT8", "float32": "FP32", "int64": "INT64"}
    raw = base64.b64encode(array.tobytes()).decode()
    return {"datatype": names[array.dtype.name], "shape": list(array.shape), "raw": raw}


def exchange(connection: socket.socket, data: bytes) -> bytes:
    received = b""
    try:
        connection.sendall(data)
        while part := connection.recv(65536):
            received += part
    except (ConnectionResetError, BrokenPipeError):
        pass
    return received


StartFaulty = Callable[..., Faulty]


@pytest.fixture(scope="module")
def start_faulty(start_module_service: Callable[..., Any]) -> Iterator[StartFaulty]:
    """A function that starts the faulty service, or another; at the end of the module none may have logged a bug."""
    started: list[Faulty] = []

    def start(data_dir: Path | None = None, *, module: str = "tests.faults.faulty_service", **environ: str) -> Faulty:
        environ["FREEREIN_SHIPPED_DIR"] = "none"  # the scripts load no other models than theirs
        service = start_module_service(module, data_dir, **environ)
        token = environ.get("FREEREIN_TOKEN", "")
        headers = {"authorization": f"Bearer {token}"} if token else {}
        http = httpx.Client(base_url=service.url, headers=headers, timeout=120, trust_env=False, verify=False)
        started.append(Faulty(service, http, token))
        return started[-1]

    yield start
    for faulty in started:
        faulty.http.close()
        others = [line for line in faulty.service.log.read_text().splitlines() if '"the model failed"' not in line]
        assert not [line for line in others if any(bug in line for bug in _BUGS)]


@pytest.fixture(scope="module")
def start_policy(start_faulty: StartFaulty) -> StartFaulty:
    """A function that starts the service of the faulty policy, and returns when it is ready."""

    def start(data_dir: Path | None = None, **environ: str) -> Faulty:
        faulty = start_faulty(data_dir, module="tests.faults.faulty_policy", **environ)
        faulty.service.until_ready()
        return faulty

    return start


Refusal = Callable[..., dict[str, Any]]


@pytest.fixture
def refusal() -> Refusal:
    """A function that checks that a reply is a problem document of a given status and leaks nothing; returns it."""

    def check(reply: httpx.Response, *statuses: int) -> dict[str, Any]:
        assert reply.status_code in statuses, reply.text[:1000]
        assert reply.headers["content-type"] == "application/problem+json"
        assert len(reply.content) <= 4096
        assert not _LEAKS.search(reply.text), reply.text
        problem: dict[str, Any] = reply.json()
        assert set(problem) == {"type", "title", "status", "code", "detail", "field", "hint", "request_id"}
        assert problem["hint"]
        assert reply.headers["x-request-id"] == problem["request_id"]
        assert ("retry-after" in reply.headers) == (reply.status_code in (429, 503))
        return problem

    return check


LeastOfMany = Callable[..., float]


@pytest.fixture
def least_of_many() -> LeastOfMany:
    """A function that measures until a value is below a bound, ten times at most: load only adds to values."""

    def measure_until(measure: Callable[[], float], *, below: float) -> float:
        least = measure()
        for _ in range(9):
            least = least if least < below else min(least, measure())
        return least

    return measure_until


@pytest.fixture
def repeats() -> int:
    """How often a row is repeated: seldom in `make test`, often in `make fuzz`."""
    return 20 if FUZZ else 1


@pytest.fixture
def fuzz() -> bool:
    """Whether the long counts are wanted."""
    return FUZZ
