"""What is deleted is gone at once, what is in use stays, and nothing half deleted is ever listed."""

import fcntl
import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest
from typer.testing import CliRunner, Result

from freerein.atomic_files import delete_folder
from freerein.cli.__main__ import app
from freerein.data import Dataset, DatasetSpec, FolderSource, create, imported, open_writer, truth
from freerein.data.dataset_recorder import DatasetRecorder, recording
from freerein.data.folder_locks import in_use
from freerein.data.labels import LabelsWriter
from freerein.data.removal import replace as replace_dataset
from freerein.errors import FailedPrecondition, InvalidInput, NotFound, Overloaded, Unavailable
from freerein.jobs.in_use import IsNamed, check_unused, names_dataset, names_model, names_run
from freerein.jobs.store import JobStore
from freerein.model_store import ModelStore
from freerein.serving.model_cache import ModelCache
from freerein.types.common import ActionSpec, Camera, ModelRef, Trajectory
from freerein.types.learning import ActivateModelRequest, DeleteModelRequest
from freerein.types.sim import DemonstrateRequest, DemonstrateResponse, ListTasksResponse, Task

RUN = "8bc1f7" + "0" * 26
SPEC = DatasetSpec(fps=10, cameras={"top": (4, 5, 3)}, action=ActionSpec(2, 0, ("x", "y")), robot_type="arm")
DISTILL = {"dataset": "demos", "model_name": "tiny", "dagger_iterations": 2}
POLICY = {"policy": {"model": "tiny", "version": "1" * 12}}
RECOGNIZER = {"recognizer": "tiny", "recognizer_version": "1" * 12}


@pytest.fixture
def store(tmp_path: Path) -> ModelStore:
    return ModelStore(tmp_path / "models", tmp_path / "shipped")


@pytest.fixture
def models(store: ModelStore) -> ModelCache[str]:
    return ModelCache(store, lambda folder: (folder / "weights").read_text(), fit_command="freerein fit toy")


def published(tmp_path: Path, weights: str, name: str = "tiny", where: str = "models") -> ModelRef:
    folder = tmp_path / "unpublished"
    folder.mkdir()
    (folder / "weights").write_text(weights)
    (folder / "card.json").write_text(json.dumps({"weights": weights}))
    return ModelStore(tmp_path / where).publish(name, folder)


def job(data_dir: Path, folder: str, config: dict[str, Any]) -> str:
    """Returns the id of a fit or run that has not ended."""
    return JobStore(data_dir / folder, noun="run").create({"idempotency_key": ""}, config)


async def test_an_active_version_is_deleted_only_where_that_is_asked_for(
    tmp_path: Path, store: ModelStore, models: ModelCache[str]
) -> None:
    first, second = published(tmp_path, "a"), published(tmp_path, "b")
    for ref in (first, second):
        await models.activate_model(ActivateModelRequest("tiny", ref.version))
    for version in (second.version, ""):
        with pytest.raises(FailedPrecondition, match=second.version):
            await models.delete_model(DeleteModelRequest("tiny", version))
    assert len(store.models()) == 2
    assert (await models.delete_model(DeleteModelRequest("tiny", first.version))).models == (first,)
    with pytest.raises(NotFound):  # though it was in memory
        await models.resolve(first)
    assert (await models.delete_model(DeleteModelRequest("tiny", even_active=True))).models == (second,)
    assert (store.names(), store.active_version("tiny")) == ((), "")
    with pytest.raises(NotFound):
        await models.delete_model(DeleteModelRequest("tiny"))


async def test_a_model_that_comes_with_freerein_stays_and_answers_again(
    tmp_path: Path, store: ModelStore, models: ModelCache[str]
) -> None:
    shipped = published(tmp_path, "a", "default", where="shipped")
    ModelStore(tmp_path / "shipped").activate(shipped)
    store.activate(published(tmp_path, "b", "default"))
    with pytest.raises(InvalidInput):
        await models.delete_model(DeleteModelRequest("", even_active=True))
    await models.delete_model(DeleteModelRequest("default", even_active=True))
    assert (await models.resolve(ModelRef()))[0] == shipped
    with pytest.raises(FailedPrecondition, match="comes with freerein"):
        await models.delete_model(DeleteModelRequest("default", shipped.version, even_active=True))


async def test_of_versions_of_which_one_is_in_use_all_stay(tmp_path: Path, store: ModelStore) -> None:
    refs = {published(tmp_path, "a"), published(tmp_path, "b")}

    def check(ref: ModelRef) -> None:
        if ref == max(refs, key=lambda each: each.version):
            raise FailedPrecondition("A model must not be in use.")

    models = ModelCache(store, str, fit_command="freerein fit toy", check_unused=check)
    with pytest.raises(FailedPrecondition):
        await models.delete_model(DeleteModelRequest("tiny"))
    assert {model.ref for model in store.models()} == refs


@pytest.mark.fault("O16")
def test_what_a_killed_deletion_left_is_listed_nowhere_and_goes_with_the_next(tmp_path: Path) -> None:
    store, runs = ModelStore(tmp_path / "models"), JobStore(tmp_path / "runs", noun="run")
    left, deleted = published(tmp_path, "a"), published(tmp_path, "b")
    store.folder(left).rename(tmp_path / "models" / "tiny" / ".deleted-00000000")
    assert [model.ref for model in store.models()] == [deleted] == list(store.published("tiny"))
    run_id, other = (job(tmp_path, "runs", {}) for _ in "ab")
    runs.folder(run_id).rename(tmp_path / "runs" / ".deleted-00000000")
    assert runs.page(0, "") == ([other], "")
    delete_folder(runs.folder(other))
    store.delete([deleted])
    assert [path.name for path in (tmp_path / "models").iterdir()] == [".lock"]
    assert [path.name for path in (tmp_path / "runs").iterdir()] == [".lock"]


def test_a_job_whose_child_has_not_ended_is_not_deleted_yet(tmp_path: Path) -> None:
    runs = JobStore(tmp_path / "runs", noun="run", links=tmp_path / "named")
    run_id = runs.create({"idempotency_key": ""}, {"kind": "ppo", "config": {}})
    with (runs.folder(run_id) / "lock").open("ab") as held:  # as an attempt and its child have it
        fcntl.flock(held, fcntl.LOCK_EX)
        with pytest.raises(Overloaded):
            runs.delete(run_id)
    assert list((tmp_path / "named").iterdir())
    runs.delete(run_id)
    assert not list((tmp_path / "named").iterdir())


@pytest.mark.fault("O16")
@pytest.mark.parametrize(
    ("folder", "config", "is_named"),
    [
        ("fits/segmentation", {"dataset": "demos", "config": {}}, names_dataset("demos")),
        ("runs", {"kind": "collect", "config": {"dataset": "demos"}}, names_dataset("demos")),
        ("runs", {"config": {"steps": [{"config": {"dataset": "demos"}}]}}, names_dataset("demos")),
        ("runs", {"kind": "skills", "config": {"name": "demos"}}, names_dataset("demos")),
        ("runs", {"kind": "skills", "config": {"name": "tiny"}}, names_model(ModelRef("tiny", "1" * 12))),
        ("runs", {"kind": "distill", "config": DISTILL}, names_dataset("demos.0")),
        ("runs", {"config": {"steps": [{"config": DISTILL}]}}, names_dataset("demos.1")),
        ("runs", {"kind": "distill", "config": DISTILL}, names_model(ModelRef("tiny.1", "1" * 12))),
        ("runs", {"config": {"reward_model": "tiny"}}, names_model(ModelRef("tiny", "1" * 12))),
        ("fits/imitation", {"config": RECOGNIZER}, names_model(ModelRef("tiny", "1" * 12))),
        ("runs", {"config": POLICY}, names_model(ModelRef("tiny", "1" * 12))),
        ("runs", {"config": {"init_from": RUN}}, names_run(RUN)),
        ("runs", {"config": {"policy": {"run": RUN[:8]}}}, names_run(RUN)),
        ("runs", {"config": {"teachers": [RUN]}}, names_run(RUN)),
    ],
)
def test_what_a_fit_or_run_names_is_in_use_until_it_has_ended(
    tmp_path: Path, folder: str, config: dict[str, Any], is_named: IsNamed
) -> None:
    job_id = job(tmp_path, folder, config)
    with pytest.raises(FailedPrecondition, match=f"{'fit' if 'fits' in folder else 'run'} {job_id[:8]}"):
        check_unused(tmp_path, "It", is_named)
    JobStore(tmp_path / folder, noun="run").record(job_id, "cancelled")
    check_unused(tmp_path, "It", is_named)


def test_the_datasets_of_a_run_that_names_none_have_its_id_and_are_in_use(tmp_path: Path) -> None:
    run_id = job(tmp_path, "runs", {"kind": "distill", "config": {"dataset": ""}})
    for name in (run_id, f"{run_id}.0", f"{run_id}.student.0"):
        with pytest.raises(FailedPrecondition, match=run_id[:8]):
            check_unused(tmp_path, "It", names_dataset(name))
    check_unused(tmp_path, "It", names_dataset("f" * 32))


@pytest.mark.parametrize("damage", ["", "5"])
def test_a_job_whose_configuration_is_damaged_may_use_anything_and_is_named(tmp_path: Path, damage: str) -> None:
    run_id = job(tmp_path, "runs", {})
    (tmp_path / "runs" / run_id / "config.json").write_text(damage)
    with pytest.raises(FailedPrecondition, match=f"run {run_id[:8]}, .* is damaged"):
        check_unused(tmp_path, "It", names_dataset("demos"))
    (tmp_path / "runs" / run_id / "events.jsonl").write_text("5\n")  # nobody can attempt it
    check_unused(tmp_path, "It", names_dataset("demos"))


@pytest.mark.parametrize(
    ("config", "is_named"),
    [
        ({"config": {"task": "demos"}}, names_dataset("demos")),
        ({"config": {"steps": [{"name": "demos", "kind": "collect", "config": {}}]}}, names_dataset("demos")),
        ({"config": DISTILL}, names_dataset("demos.2")),
        ({"config": {"dataset": "demos"}}, names_dataset("demos.0")),
        ({"config": POLICY}, names_model(ModelRef("tiny", "2" * 12))),
        ({"config": {"model_name": "tiny"}}, names_model(ModelRef("tiny", "1" * 12))),
        ({"config": {"init_from": "9" + RUN[1:]}}, names_run(RUN)),
    ],
)
def test_another_thing_of_a_similar_name_is_not_in_use(
    tmp_path: Path, config: dict[str, Any], is_named: IsNamed
) -> None:
    job(tmp_path, "runs", config)
    check_unused(tmp_path, "It", is_named)


@pytest.fixture
def demos(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of the dataset `demos`, of one trajectory."""
    monkeypatch.setenv("FREEREIN_DATA_DIR", str(tmp_path))
    recorded(tmp_path / "datasets" / "demos")
    return tmp_path / "datasets" / "demos"


def recorded(root: Path, frames: int = 3) -> Path:
    with create(root, SPEC) as writer:
        writer.append(trajectory(frames))
    return root


def trajectory(frames: int) -> Trajectory:
    return Trajectory({"top": np.zeros((frames, 4, 5, 3), np.uint8)}, np.zeros((frames, 2), np.float32))


def images(folder: Path, *sizes: int) -> FolderSource:
    """Returns the frames of a folder of images, square of so many pixels each."""
    (folder / "take").mkdir(parents=True)
    for number, size in enumerate(sizes):
        PIL.Image.new("RGB", (size, size)).save(folder / "take" / f"{number}.png")
    return FolderSource(folder)


def freerein(*words: str) -> Result:
    return CliRunner().invoke(app, list(words))


def test_a_dataset_is_deleted_damaged_or_not_and_of_a_link_the_link_alone(tmp_path: Path, demos: Path) -> None:
    (recorded(tmp_path / "datasets" / "damaged") / "meta/info.json").unlink()
    elsewhere = recorded(tmp_path / "elsewhere")
    demos.with_name("linked").symlink_to(elsewhere)
    result = freerein("dataset", "rm", "demos", "damaged", "linked")
    assert (result.exit_code, result.stdout.count("Deleted dataset")) == (0, 3)
    assert not list(demos.parent.iterdir())
    assert len(Dataset(elsewhere)) == 1
    again = freerein("dataset", "rm", "demos", "--json")
    assert json.loads(again.stderr)["error"]["code"] == "not_found"


def test_a_dataset_that_a_fit_reads_or_a_process_writes_stays_and_is_not_replaced(tmp_path: Path, demos: Path) -> None:
    images(tmp_path / "pictures", 4)
    for writer in (open_writer(demos), LabelsWriter(demos, name="a process")):
        with writer:
            assert "dataset demos must not be in use" in freerein("dataset", "rm", "demos").stderr
    fit = job(tmp_path, "fits/segmentation", {"dataset": "demos"})
    for words in (["rm", "demos"], ["import", str(tmp_path / "pictures"), "demos", "--replace"]):
        result = freerein("dataset", *words)
        assert result.exit_code == 1
        assert f"fit {fit[:8]}" in result.stderr
    assert len(Dataset(demos)[0].actions) == 3


def test_a_dataset_is_replaced_once_the_new_one_is_whole(tmp_path: Path, demos: Path) -> None:
    pictures = str(tmp_path / "pictures")
    images(tmp_path / "pictures", 4, 4)
    (tmp_path / "pictures/take/2.png").write_bytes(b"torn")
    taken = freerein("dataset", "import", pictures, "demos")
    assert "--replace" in taken.stderr
    assert freerein("dataset", "import", pictures, "demos", "--replace").exit_code == 1
    assert len(Dataset(demos)[0].actions) == 3
    (tmp_path / "pictures/take/2.png").unlink()
    assert freerein("dataset", "import", pictures, "demos", "--replace").exit_code == 0
    assert Dataset(demos).lengths.tolist() == [2]
    assert [path.name for path in demos.parent.iterdir()] == ["demos"]


def test_a_dataset_whose_replacement_fails_or_is_of_no_use_stays(tmp_path: Path, demos: Path) -> None:
    def refuse() -> None:
        assert len(Dataset(demos)[0].actions) == 1
        raise FailedPrecondition("A fit is refused.")

    with pytest.raises(FileNotFoundError):
        replace_dataset(demos, tmp_path / "missing", check_unused=lambda: None)
    with pytest.raises(FailedPrecondition):
        import_for(refuse, images(tmp_path / "pictures", 4), demos)
    assert len(Dataset(demos)[0].actions) == 3
    assert [path.name for path in demos.parent.iterdir()] == ["demos"]


def test_a_dataset_that_a_fit_names_by_the_end_of_an_import_or_a_recording_stays(tmp_path: Path, demos: Path) -> None:
    fits = JobStore(tmp_path / "fits/segmentation", noun="fit")
    source, check = images(tmp_path / "pictures", 4), partial(check_unused, tmp_path, "It", names_dataset("demos"))

    def queue_and_break() -> None:
        job(tmp_path, "fits/segmentation", {"dataset": "demos"})
        raise Unavailable("No answer came.")

    fit = job(tmp_path, "fits/segmentation", {"dataset": "demos"})
    with pytest.raises(FailedPrecondition, match=f"fit {fit[:8]}"):
        import_for(lambda: None, source, demos, check_unused=check)
    with pytest.raises(FailedPrecondition, match=f"fit {fit[:8]}"):
        record(demos, demonstration(), demonstration(), check_unused=check)
    assert len(Dataset(demos)[0].actions) == 3
    fits.record(fit, "cancelled")
    with pytest.raises(Unavailable):
        import_for(queue_and_break, source, demos, check_unused=check)
    assert len(Dataset(demos)[0].actions) == 1


def import_for(use: Callable[[], None], source: FolderSource, root: Path, **options: Any) -> None:
    with imported(source, root, replaces=True, **options):
        use()


def test_a_recording_replaces_a_dataset_once_it_is_complete(demos: Path) -> None:
    with pytest.raises(InvalidInput):
        record(demos, demonstration(frames=0))
    with pytest.raises(Unavailable):
        record(demos, demonstration())
    assert len(Dataset(demos)[0].actions) == 3
    record(demos, demonstration(), demonstration())
    assert Dataset(demos).lengths.tolist() == [1, 1]
    assert [path.name for path in demos.parent.iterdir()] == ["demos"]


def record(root: Path, *demonstrations: DemonstrateResponse, **options: Any) -> None:
    """Replaces a dataset by a recording of two demonstrations, of which these arrive."""
    camera = Camera("top", 4, 5, 3)
    task = Task("pick", "arm", "", (camera,), SPEC.action, control_dt_s=0.1, skills=(), max_episode_steps=9)
    request, tasks = DemonstrateRequest("pick", "random", count=2), ListTasksResponse((task,))
    with DatasetRecorder(root, request, tasks, replaces=True, **options) as recording:
        for each in demonstrations:
            recording.append(each)
        recording.check_complete()


def demonstration(frames: int = 1) -> DemonstrateResponse:
    return DemonstrateResponse(0, replace(trajectory(frames), terminated=np.zeros(frames, np.bool_)))


def test_decoded_frames_are_pruned_and_what_killed_processes_left_and_nothing_else(tmp_path: Path, demos: Path) -> None:
    datasets, abandoned, busy = demos.parent, demos.with_name(".import-00000000"), demos.with_name(".import-00000001")
    frames = Dataset(demos).cached_frames("top")
    (cached,) = (demos / "cache").iterdir()
    kept = [
        cached / "notes.txt",
        cached / "z.raw" / "0.raw",
        cached / "actions.raw" / "0.raw",
        demos / "cache" / "mine" / "actions.raw",
        datasets / "foreign" / "cache" / cached.name / "actions.raw",
        *(datasets / name / "0" for name in (".Trash-1000", ".blocks-old", ".import-mine", ".deleted-scenes")),
    ]
    for path in kept:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("of the user")
    (cached / "terminations.raw").symlink_to(kept[0])
    (datasets / "linked").symlink_to(recorded(tmp_path / "large"))
    Dataset(datasets / "linked").cached_actions()
    kept += (tmp_path / "large/cache").rglob("*.raw")
    recorded(abandoned / "half")
    with in_use(busy):
        result = freerein("dataset", "prune", "--json")
        assert json.loads(result.stdout)["freed_bytes"] > 3 * 4 * 5 * 3
    assert all(path.is_file() for path in [*kept, cached / "terminations.raw"])
    assert (abandoned.exists(), busy.exists(), (cached / "frames-top.raw").exists()) == (False, True, False)
    assert frames[0].shape == (3, 4, 5, 3)  # a fit that reads them goes on
    assert np.array_equal(Dataset(demos).cached_frames("top")[0], frames[0])
    assert all(path.is_file() for path in kept)


def test_a_recording_of_nothing_leaves_no_dataset_and_one_that_was_killed_goes_on(tmp_path: Path) -> None:
    root = tmp_path / "datasets" / "demos"
    with pytest.raises(InvalidInput), recording(root, SPEC, {}):
        raise InvalidInput("Refused.")
    assert not list(root.parent.iterdir())
    create(root, SPEC).close()  # as a process that was killed leaves it
    with recording(root, SPEC, {"seed": 1}) as writer:
        writer.append(trajectory(1))
    with pytest.raises(FailedPrecondition, match="its own request"), recording(root, SPEC, {"seed": 2}):
        pass
    assert len(Dataset(root)) == 1


def test_a_recording_deletes_nothing_of_a_dataset_that_has_no_trajectories(tmp_path: Path) -> None:
    root = recorded(tmp_path / "demos")
    (root / "recording.json").write_text('{"seed": 1}')
    (root / "notes.txt").write_text("of the user")
    (root / "data/chunk-000").rename(root / "data/moved")
    for spec, request in ((SPEC, {"seed": 2}), (replace(SPEC, fps=20, control_dt_s=0.05), {"seed": 1})):
        with pytest.raises(FailedPrecondition), recording(root, spec, request):
            pass
    with recording(root, SPEC, {"seed": 1}):
        pass
    truth.save(root, 1, np.zeros(3, np.int64))
    with pytest.raises(FailedPrecondition, match="and none of these"), recording(root, SPEC, {"seed": 1}):
        pass
    names = {path.name for path in root.rglob("*.*")}
    assert names >= {"notes.txt", "info.json", "recording.json", "file-000.parquet", "file-001.parquet"}
