"""Metrics of fits, runs and the disk, as Prometheus reads them."""

import re
import shutil
from pathlib import Path

import httpx

from freerein.jobs.store import JobStore
from freerein.serving.health import Health
from freerein.serving.limits import Limits
from freerein.serving.metrics import Metrics
from freerein.serving.rest.app import make_app

REQUEST = {"dataset": "demos", "idempotency_key": ""}


async def read(metrics: Metrics) -> dict[str, float]:
    app = make_app("toy", [], health=Health(), metrics=metrics, limits=Limits())
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://toy") as client:
        lines = re.findall(r"^freerein_((?:jobs|running|data)\S*) (\S+)$", (await client.get("/metrics")).text, re.M)
    return {name: float(value) for name, value in lines}


async def test_jobs_are_counted_by_state_and_the_most_silent_one_is_dated(tmp_path: Path) -> None:
    times = iter(range(10**9, 10**12, 10**9))
    store = JobStore(tmp_path / "fits", noun="fit", clock_ns=lambda: next(times))
    metrics = Metrics()
    metrics.data.jobs = {"fit": tmp_path / "fits"}
    assert (await read(metrics))['jobs{kind="fit",state="queued"}'] == 0  # there is no folder yet

    silent, busy, done = (store.create(REQUEST, {"steps": 1}) for _ in range(3))
    for job in (silent, busy, done):
        store.record(job, "running", step=1)
    store.record(busy, "running", step=2)
    store.record(done, "succeeded")
    found = await read(metrics)
    assert found == {
        **{f'jobs{{kind="fit",state="{state}"}}': 0 for state in ("queued", "failed", "cancelled")},
        'jobs{kind="fit",state="running"}': 2,
        'jobs{kind="fit",state="succeeded"}': 1,
        'running_job_changed_seconds{kind="fit"}': 4,
    }
    store.record(silent, "failed", error="why")
    shutil.rmtree(store.folder(done))
    with (store.folder(busy) / "events.jsonl").open("ab") as events:
        events.write(b'{"state": "torn')
    for damage in (b"5", b"nonsense", b'{"state": "running", "time_ns": "yesterday"}'):
        with (store.folder(store.create(REQUEST, {"steps": 1})) / "events.jsonl").open("ab") as events:
            events.write(damage + b"\n")
    found = await read(metrics)
    assert [found[f'jobs{{kind="fit",state="{state}"}}'] for state in ("running", "failed", "succeeded")] == [1, 1, 0]
    assert found['running_job_changed_seconds{kind="fit"}'] == 7


async def test_the_disk_of_the_data_directory_is_measured_once_it_is_there(tmp_path: Path) -> None:
    metrics = Metrics()
    metrics.data.data_dir = tmp_path / "data"
    assert await read(metrics) == {}
    metrics.data.data_dir.mkdir()
    found = await read(metrics)
    assert 0 < found["data_free_bytes"] < found["data_size_bytes"] == shutil.disk_usage(tmp_path).total
