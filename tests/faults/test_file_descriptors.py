"""A process without free file descriptors: it refuses, does not spin, and recovers when some are free again."""

import contextlib
import resource
from collections.abc import Callable, Iterator
from typing import Any

import psutil
import pytest

from freerein.clients import Channel, ModelClient, OrchestratorClient, SyncClient
from freerein.errors import Unavailable
from freerein.types.learning import ListModelsRequest
from freerein.types.orchestrator import ListRunsRequest

pytestmark = [pytest.mark.e2e, pytest.mark.fault("C22")]
ASK = b"GET /healthz HTTP/1.1\r\nhost: localhost\r\n\r\n"
PICTURE = b"\x89PNG\r\n\x1a\n" + bytes(2 * 2**20)  # so large that it is received into a file


@pytest.fixture(scope="module")
def faulty(start_faulty: Callable[..., Any]) -> Any:
    return start_faulty()


@contextlib.contextmanager
def free_descriptors(faulty: Any, count: int) -> Iterator[None]:
    """Leaves a process about so many descriptors beyond those that it holds; 0 leaves none."""
    pid = faulty.process.pid
    held = faulty.process.num_fds()  # some may be given back in a moment, hence half of them where none is to be left
    before = resource.prlimit(pid, resource.RLIMIT_NOFILE)
    resource.prlimit(pid, resource.RLIMIT_NOFILE, (held + count if count else held // 2, before[1]))
    try:
        yield
    finally:
        resource.prlimit(pid, resource.RLIMIT_NOFILE, before)


def test_what_needs_a_file_is_refused_for_now(faulty: Any, refusal: Any) -> None:
    assert faulty.segment(2, 3).json()["labels"] == [0, 1]  # on the connection that is used below
    with free_descriptors(faulty, 0):
        for reply in (
            faulty.segment(2, 3),
            faulty.http.get("/v1/list-models"),
            faulty.http.post("/v1/segment", files={"images": ("0.png", PICTURE)}),
        ):
            assert "file descriptors" in refusal(reply, 503)["detail"]
        assert faulty.http.get("/healthz").status_code == 200
    assert faulty.segment(2, 3).json()["labels"] == [0, 1]


def test_over_grpc_what_needs_a_file_is_refused_for_now(faulty: Any) -> None:
    with SyncClient(ModelClient(Channel(faulty.service.address))) as models:
        known = models.list_models(ListModelsRequest())
        with free_descriptors(faulty, 0), pytest.raises(Unavailable, match="file descriptors") as refused:
            models.list_models(ListModelsRequest())
        assert "limit of open files" in refused.value.hint
        assert models.list_models(ListModelsRequest()) == known


def test_an_orchestrator_whose_files_or_database_cannot_be_opened_refuses_for_now(
    start_faulty: Callable[..., Any], refusal: Any, wait_until: Callable[..., float]
) -> None:
    orchestrator = start_faulty(module="freerein_orchestrator")
    wait_until(lambda: orchestrator.http.get("/readyz").is_success, 300)  # on the connection that is used below
    asked = {"kind": "collect", "config": {"task": "grid", "dataset": "few", "count": 1}}
    with SyncClient(OrchestratorClient(Channel(orchestrator.service.address))) as runs:
        runs.list_runs(ListRunsRequest())
        with free_descriptors(orchestrator, 0):
            for reply in (orchestrator.http.get("/v1/list-runs"), orchestrator.http.post("/v1/start-run", json=asked)):
                assert "limit of open files" in refusal(reply, 503)["hint"]
            with pytest.raises(Unavailable, match="file descriptors"):
                runs.list_runs(ListRunsRequest())
        assert runs.list_runs(ListRunsRequest()).runs == ()


def test_connections_beyond_the_limit_are_closed_without_spinning(faulty: Any) -> None:
    with free_descriptors(faulty, 8), contextlib.ExitStack() as stack:
        connections = [stack.enter_context(faulty.connect()) for _ in range(40)]
        served = [reply for connection in connections if (reply := ask(connection))]
        assert all(reply.startswith(b"HTTP/1.1 200") for reply in served)
        assert 0 < len(served) < 20
        before = faulty.cpu_s()
        with contextlib.suppress(psutil.TimeoutExpired):
            faulty.process.wait(1.0)
        assert faulty.cpu_s() - before < 0.3
    assert faulty.segment(2, 3).json()["labels"] == [0, 1]


def ask(connection: Any) -> bytes:
    """Returns the beginning of a reply, empty when the connection is closed."""
    try:
        connection.sendall(ASK)
        answer: bytes = connection.recv(4096)
    except (ConnectionResetError, BrokenPipeError):
        return b""
    return answer
