"""What is deleted is gone at once, what is in use stays, and nothing half deleted is ever listed."""

import fcntl
import json
from pathlib import Path
from typing import Any

import pytest

from freerein.atomic_files import delete_folder
from freerein.errors import FailedPrecondition, NotFound, Overloaded
from freerein.jobs.in_use import IsNamed, check_unused, names_dataset, names_model, names_run
from freerein.jobs.store import JobStore
from freerein.serving.model_cache import ModelCache
from freerein.serving.model_store import ModelStore
from freerein.types.common import ModelRef
from freerein.types.learning import ActivateModelRequest, DeleteModelRequest

RUN = "8bc1f7" + "0" * 26
POLICY = {"policy": {"model": "tiny", "version": "1" * 12}}


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
    await models.delete_model(DeleteModelRequest("", even_active=True))
    assert (await models.resolve(ModelRef()))[0] == shipped
    with pytest.raises(FailedPrecondition, match="comes with freerein"):
        await models.delete_model(DeleteModelRequest("", shipped.version, even_active=True))


async def test_of_versions_of_which_one_is_in_use_all_stay(tmp_path: Path, store: ModelStore) -> None:
    refs = {published(tmp_path, "a"), published(tmp_path, "b")}

    def check(ref: ModelRef) -> None:
        if ref == max(refs, key=lambda each: each.version):
            raise FailedPrecondition("A model must not be in use.")

    models = ModelCache(store, str, fit_command="freerein fit toy", check_unused=check)
    with pytest.raises(FailedPrecondition):
        await models.delete_model(DeleteModelRequest("tiny"))
    assert {model.ref for model in store.models()} == refs


def test_what_a_killed_deletion_left_is_listed_nowhere_and_goes_with_the_next(tmp_path: Path) -> None:
    store, runs = ModelStore(tmp_path / "models"), JobStore(tmp_path / "runs", noun="run")
    left, deleted = published(tmp_path, "a"), published(tmp_path, "b")
    store.folder(left).rename(tmp_path / "models" / "tiny" / ".deleted-0")
    assert [model.ref for model in store.models()] == [deleted]
    run_id, other = (job(tmp_path, "runs", {}) for _ in "ab")
    runs.folder(run_id).rename(tmp_path / "runs" / ".deleted-0")
    assert runs.page(0, "") == ([other], "")
    delete_folder(runs.folder(other))
    store.delete([deleted])
    assert not list((tmp_path / "models").iterdir())
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


@pytest.mark.parametrize(
    ("folder", "config", "is_named"),
    [
        ("fits/segmentation", {"dataset": "demos", "config": {}}, names_dataset("demos")),
        ("runs", {"kind": "collect", "config": {"dataset": "demos"}}, names_dataset("demos")),
        ("runs", {"config": {"steps": [{"config": {"dataset": "demos"}}]}}, names_dataset("demos")),
        ("runs", {"kind": "skills", "config": {"name": "demos"}}, names_dataset("demos")),
        ("runs", {"config": {"reward_model": "tiny"}}, names_model(ModelRef("tiny", "1" * 12))),
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


@pytest.mark.parametrize(
    ("config", "is_named"),
    [
        ({"config": {"task": "demos"}}, names_dataset("demos")),
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
