"""Watchers of a fit: more than may be open at once, and of events that cannot be read."""

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from freerein.clients import Channel, FitClient, SyncClient
from freerein.data import DatasetSpec, create
from freerein.errors import OutOfStorage
from freerein.types.common import ActionSpec, Trajectory
from freerein.types.learning import WatchFitRequest

pytestmark = pytest.mark.e2e
STREAMS = 64


def start_long_fit(faulty: Any, data_dir: Path) -> str:
    spec = DatasetSpec(10, {"front": (16, 16, 3)}, ActionSpec(2, 0, ("x", "y")), "none", ("close", "open"))
    with create(data_dir / "datasets" / "demos", spec) as writer:
        for _ in range(4):
            frames = {"front": np.zeros((4, 16, 16, 3), np.uint8)}
            writer.append(Trajectory(frames, np.zeros((4, 2), np.float32), ("close", "open")))
    config = {"steps": 1_000_000, "features": 8, "hidden_size": 8}
    reply = faulty.http.post("/v1/start-fit", json={"dataset": "demos", "config": config})
    assert reply.status_code == 200, reply.text
    return str(reply.json()["fit"]["id"])


@pytest.mark.fault("I12")
def test_a_watcher_above_the_limit_is_refused_at_once_and_the_others_go_on(
    start_faulty: Callable[..., Any], tmp_path: Path, refusal: Callable[..., Any]
) -> None:
    faulty = start_faulty(tmp_path)
    fit_id = start_long_fit(faulty, tmp_path)
    limits = httpx.Limits(max_connections=None)
    with (
        httpx.Client(base_url=faulty.service.url, timeout=120, limits=limits, trust_env=False) as client,
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
def test_events_that_a_broken_disk_does_not_return_are_out_of_storage(
    start_faulty: Callable[..., Any], tmp_path: Path, refusal: Callable[..., Any]
) -> None:
    faulty = start_faulty(tmp_path)
    fit_id = start_long_fit(faulty, tmp_path)
    faulty.http.post("/v1/cancel-fit", json={"id": fit_id})
    events = tmp_path / "fits" / "segmentation" / fit_id / "events.jsonl"
    events.unlink()
    events.symlink_to("/proc/self/mem")  # a regular file whose first page cannot be read: EIO
    problem = refusal(faulty.http.get("/v1/watch-fit", params={"id": fit_id}), 507)
    assert (problem["code"], "Input/output error" in problem["detail"]) == ("out_of_storage", True)
    with SyncClient(FitClient(Channel(faulty.service.address))) as fits, pytest.raises(OutOfStorage, match="must work"):
        list(fits.watch_fit(WatchFitRequest(fit_id)))
