"""Runs of kind `fit`, with the real imitation service, and with one that speaks gRPC and nothing of ours."""
# ruff: noqa: N802 -- gRPC names the methods

import shutil
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import grpc
import numpy as np
import pytest

from freerein import wire
from freerein.api.learning.v1 import learning_pb2_grpc
from freerein.clients import Channel, FitClient, SyncClient
from freerein.data import DatasetSpec, create, dataset_path
from freerein.errors import FailedPrecondition, InvalidInput, NotFound
from freerein.types.common import ActionSpec, ModelRef, Trajectory
from freerein.types.learning import (
    Fit,
    GetFitResponse,
    ListFitsRequest,
    ResumeFitResponse,
    StartFitResponse,
    WatchFitResponse,
)
from freerein_orchestrator.kinds import KINDS

pytestmark = pytest.mark.e2e
STEPS = 20
TINY = {"steps": STEPS, "batch_size": 2, "features": 8, "hidden_size": 8, "embedding_size": 4, "log_every": 5}
FIT = {"service": "imitation", "dataset": "play", "config": TINY}


@pytest.fixture(scope="module")
def data_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data directory with a dataset of exploration."""
    data_dir, rng = tmp_path_factory.mktemp("data"), np.random.default_rng(0)
    spec = DatasetSpec(25, {"front": (12, 12, 3)}, ActionSpec(2, 0, ("dy", "dz"), "m", (0.05, 0.05)), "test")
    with create(dataset_path(data_dir, "play"), spec) as writer:
        for _ in range(4):
            frames = rng.integers(0, 256, (24, 12, 12, 3), np.uint8)
            writer.append(Trajectory({"front": frames}, rng.uniform(-1, 1, (24, 2)).astype(np.float32)))
    return data_dir


@pytest.fixture(scope="module")
def imitation(mortal: Callable[..., Any], data_dir: Path) -> Any:
    return mortal("freerein_imitation", data_dir=data_dir, FREEREIN_SHIPPED_DIR="none")


@pytest.fixture
def fits(imitation: Any) -> Iterator[Callable[[], list[Any]]]:
    """A function that returns the service's fits of this test, newest first."""
    with SyncClient(FitClient(Channel(imitation.address))) as client:
        before = len(client.list_fits(ListFitsRequest()).fits)
        yield lambda: list(client.list_fits(ListFitsRequest()).fits[: -before or None])


@pytest.fixture
def run(new_run: Callable[..., Any], data_dir: Path, imitation: Any) -> Any:
    return new_run(data_dir, "fit", FIT, FREEREIN_IMITATION_ADDRESS=imitation.address)


def test_a_run_whose_child_is_killed_makes_one_fit_and_shows_its_whole_curve(
    run: Any, fits: Callable[[], list[Any]]
) -> None:
    run.kill_when(fits)
    assert run.do()
    (fit,) = fits()
    assert (fit.state, run.model) == ("succeeded", fit.model)
    steps = [row["step"] for row in run.rows]
    assert steps == sorted(set(steps))
    assert (steps[-1], "validation_loss" in run.rows[-1]) == (STEPS, True)


def test_a_run_told_to_stop_leaves_its_fit_and_a_cancelled_one_cancels_it_and_resumes_it_when_resumed(
    run: Any, fits: Callable[[], list[Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("freerein_orchestrator.kinds.fit._CANCEL_S", 60.0)
    assert not run.do(stop=lambda: bool(fits()))
    assert not fits()[0].ended
    assert not run.do(stop=lambda: True)
    assert len(fits()) == 1
    assert not run.do(stop=Nth(2), cancelled=True)
    assert fits()[0].state == "cancelled"
    assert run.do()
    assert [fit.state for fit in fits()] == ["succeeded"]


@pytest.mark.fault("O2")
def test_a_run_waits_for_a_service_that_is_killed_and_goes_on_with_its_fit(
    new_run: Callable[..., Any], data_dir: Path, imitation: Any, fits: Callable[[], list[Any]]
) -> None:
    config = FIT | {"config": TINY | {"steps": 5 * STEPS}}  # so that it goes on when its service is back
    run = new_run(data_dir, "fit", config, FREEREIN_IMITATION_ADDRESS=imitation.address)
    replacing = imitation.replaced_at(1, since=fits)
    assert run.do(stop=replacing)
    assert replacing.is_done
    assert run.rows[-1]["step"] == 5 * STEPS
    assert len(fits()) == 1


def test_a_run_fails_for_the_reason_of_its_fit_and_resumes_it_once_that_is_mended(
    new_run: Callable[..., Any], data_dir: Path, imitation: Any
) -> None:
    def doing(**wrong: Any) -> bool:
        return bool(new_run(data_dir, "fit", FIT | wrong, FREEREIN_IMITATION_ADDRESS=imitation.address).do())

    with pytest.raises(NotFound):
        doing(dataset="none")
    with pytest.raises(InvalidInput, match="steps"):
        doing(config={"step": 3})
    broken = dataset_path(data_dir, "broken")
    shutil.copytree(dataset_path(data_dir, "play"), broken, ignore=shutil.ignore_patterns("cache"))
    for path in (broken / "data").rglob("*.parquet"):
        path.write_bytes(path.read_bytes()[:4] + bytes(path.stat().st_size - 4))
    run = new_run(data_dir, "fit", FIT | {"dataset": "broken"}, FREEREIN_IMITATION_ADDRESS=imitation.address)
    full = run.folder / "fit.json.tmp"

    def fill_the_disk() -> bool:
        if (run.folder / "fit.json").is_file() and not full.is_symlink():
            full.symlink_to("/dev/full")
        return False

    with pytest.raises(FailedPrecondition, match="Trajectory"):
        run.do(stop=fill_the_disk)
    full.unlink()
    for path in (broken / "data").rglob("*.parquet"):
        shutil.copyfile(dataset_path(data_dir, "play") / path.relative_to(broken), path)
    assert run.do()


@pytest.mark.parametrize(
    "wrong",
    [
        {"service": "sim"},
        {"dataset": "../play"},
        {"model_name": "A"},
        {"config": []},
        {"steps": 3},
        *({"config": {"steps": steps}} for steps in (-5, 1e30, 2**31, 0.5, float("nan"), float("inf"), True, "3", [3])),
    ],
)
def test_a_fit_of_no_service_or_no_name_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(InvalidInput) as error:
        KINDS["fit"].parse(FIT | wrong)
    assert error.value.field.startswith("config")


def test_the_steps_of_a_fit_are_those_asked_for() -> None:
    assert KINDS["fit"].steps(KINDS["fit"].parse(FIT)) == STEPS
    assert KINDS["fit"].steps(KINDS["fit"].parse(FIT | {"config": {"steps": 3.0}})) == 3
    assert KINDS["fit"].steps(KINDS["fit"].parse(FIT | {"config": {}})) == 0


def test_the_old_end_of_a_fit_that_was_resumed_is_not_its_end(new_run: Callable[..., Any], tmp_path: Path) -> None:
    with serving(ResumedFits()) as address:
        run = new_run(tmp_path, "fit", FIT, FREEREIN_IMITATION_ADDRESS=address)
        assert run.do()
    assert (run.model, [row["step"] for row in run.rows]) == (ModelRef("default", "new"), [1, 2])


class ResumedFits(learning_pb2_grpc.FitServiceServicer):
    """One fit, which has failed; the events after its old end come later than any watcher waits at a time."""

    FIT = Fit("0" * 32, "failed", {}, step=1, metrics={"loss": 2.0}, error="Old.", dataset="play", model_name="default")
    ENDED = replace(FIT, state="succeeded", step=2, error="", model=ModelRef("default", "new"))

    def StartFit(self, _request, _context):
        return wire.pack(StartFitResponse(self.FIT))

    def ResumeFit(self, _request, _context):
        return wire.pack(ResumeFitResponse(replace(self.FIT, state="queued", error="")))

    def GetFit(self, _request, _context):
        return wire.pack(GetFitResponse(replace(self.FIT, state="running", error="")))

    def WatchFit(self, request, context):
        if request.from_sequence == 0:
            yield wire.pack(WatchFitResponse(0, self.FIT))
            wait_until_gone(context)
        else:
            yield wire.pack(WatchFitResponse(1, self.ENDED))


def test_a_fit_ends_for_a_run_that_finds_its_last_events_only_after_long(
    new_run: Callable[..., Any], tmp_path: Path
) -> None:
    with serving(FitsOfManyEvents()) as address:
        run = new_run(tmp_path, "fit", FIT, FREEREIN_IMITATION_ADDRESS=address)
        assert run.do()
    assert (run.model, [row["step"] for row in run.rows]) == (ModelRef("default", "new"), [1, 2])


class FitsOfManyEvents(ResumedFits):
    """One fit, which has succeeded; a watcher who waits for a moment only has gone before its last event is found."""

    def GetFit(self, _request, _context):
        return wire.pack(GetFitResponse(self.ENDED))

    def WatchFit(self, request, context):
        if request.from_sequence == 0:
            yield wire.pack(WatchFitResponse(0, self.FIT))
        if context.time_remaining() < 1:
            wait_until_gone(context)
        yield wire.pack(WatchFitResponse(1, self.ENDED))


@contextmanager
def serving(fits: ResumedFits) -> Iterator[str]:
    """Yields the address of a service that knows nothing but fits."""
    server = grpc.server(ThreadPoolExecutor(4))
    learning_pb2_grpc.add_FitServiceServicer_to_server(fits, server)
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    yield f"127.0.0.1:{port}"
    server.stop(None).wait()


def wait_until_gone(context: Any) -> None:
    """Returns when the caller has gone."""
    gone = threading.Event()
    context.add_callback(gone.set)
    gone.wait()


class Nth:
    """Answers True the n-th time that it is asked."""

    def __init__(self, n: int) -> None:
        self._left = n

    def __call__(self) -> bool:
        self._left -= 1
        return self._left == 0
