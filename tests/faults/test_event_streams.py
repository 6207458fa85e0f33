"""Watchers of a fit: more than may be open at once, and of events that cannot be read."""

from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import httpx
import pytest
from tests.faults.demonstrations import record_demonstrations

from freerein.clients import Channel, FitClient, SyncClient
from freerein.errors import OutOfStorage
from freerein.types.learning import WatchFitRequest

pytestmark = pytest.mark.e2e
STREAMS = 64


@pytest.fixture(scope="module")
def faulty(start_faulty: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory) -> Any:
    data_dir = tmp_path_factory.mktemp("data")
    record_demonstrations(data_dir)
    return start_faulty(data_dir)


def start_long_fit(faulty: Any) -> str:
    config = {"steps": 1_000_000, "features": 8, "hidden_size": 8}
    reply = faulty.http.post("/v1/start-fit", json={"dataset": "demos", "config": config})
    assert reply.status_code == 200, reply.text
    return str(reply.json()["fit"]["id"])


@pytest.mark.fault("I12")
def test_a_watcher_above_the_limit_is_refused_at_once_and_the_others_go_on(
    faulty: Any, refusal: Callable[..., Any]
) -> None:
    fit_id = start_long_fit(faulty)
    options: Any = {"limits": httpx.Limits(max_connections=None), "trust_env": False, "verify": False}
    with (
        httpx.Client(base_url=faulty.service.url, timeout=120, **options) as client,
        ExitStack() as watching,
    ):
        watch = ("GET", "/v1/watch-fit")
        watchers = [watching.enter_context(client.stream(*watch, params={"id": fit_id})) for _ in range(STREAMS)]
        assert {watcher.status_code for watcher in watchers} == {200}
        problem = refusal(client.get(watch[1], params={"id": fit_id}), 429)
        assert problem["detail"].startswith(f"At most {STREAMS} streams")
        faulty.http.post("/v1/cancel-fit", json={"id": fit_id})
        for watcher in watchers:
            assert '"cancelled"' in watcher.read().decode()
        assert client.get(watch[1], params={"id": fit_id}).status_code == 200


@pytest.mark.fault("C21")
def test_events_that_a_broken_disk_does_not_return_are_out_of_storage(faulty: Any, refusal: Callable[..., Any]) -> None:
    fit_id = start_long_fit(faulty)
    faulty.http.post("/v1/cancel-fit", json={"id": fit_id})
    events = faulty.service.data_dir / "fits" / "segmentation" / fit_id / "events.jsonl"
    events.unlink()
    events.symlink_to("/proc/self/mem")  # a regular file whose first page cannot be read: EIO
    problem = refusal(faulty.http.get("/v1/watch-fit", params={"id": fit_id}), 507)
    assert (problem["code"], "Input/output error" in problem["detail"]) == ("out_of_storage", True)
    with SyncClient(FitClient(Channel(faulty.service.address))) as fits, pytest.raises(OutOfStorage, match="must work"):
        list(fits.watch_fit(WatchFitRequest(fit_id)))
