"""Watchers of a fit whose events cannot be read."""

from collections.abc import Callable
from typing import Any

import pytest
from tests.faults.demonstrations import record_demonstrations

from freerein.clients import Channel, FitClient, SyncClient
from freerein.errors import OutOfStorage
from freerein.types.learning import WatchFitRequest

pytestmark = pytest.mark.e2e


@pytest.fixture(scope="module")
def faulty(start_faulty: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory) -> Any:
    data_dir = tmp_path_factory.mktemp("data")
    record_demonstrations(data_dir)
    return start_faulty(data_dir)


@pytest.mark.fault("C21")
def test_events_that_a_broken_disk_does_not_return_are_out_of_storage(faulty: Any, refusal: Callable[..., Any]) -> None:
    config = {"steps": 1_000_000, "features": 8, "hidden_size": 8}
    reply = faulty.http.post("/v1/start-fit", json={"dataset": "demos", "config": config})
    assert reply.status_code == 200, reply.text
    fit_id = reply.json()["fit"]["id"]
    faulty.http.post("/v1/cancel-fit", json={"id": fit_id})
    events = faulty.service.data_dir / "fits" / "segmentation" / fit_id / "events.jsonl"
    events.unlink()
    events.symlink_to("/proc/self/mem")  # a regular file whose first page cannot be read: EIO
    problem = refusal(faulty.http.get("/v1/watch-fit", params={"id": fit_id}), 507)
    assert (problem["code"], "Input/output error" in problem["detail"]) == ("out_of_storage", True)
    with SyncClient(FitClient(Channel(faulty.service.address))) as fits, pytest.raises(OutOfStorage, match="must work"):
        list(fits.watch_fit(WatchFitRequest(fit_id)))
