"""Models on disk and in memory: a version never changes, and what is broken is never loaded."""

import asyncio
import json
import shutil
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest

from freerein.errors import FailedPrecondition, InvalidInput, NotFound
from freerein.model_store import ModelStore
from freerein.serving.model_cache import ModelCache
from freerein.types.common import ModelRef
from freerein.types.learning import ActivateModelRequest, ListModelsRequest

Publish = Callable[..., ModelRef]


@pytest.fixture
def store(tmp_path: Path) -> ModelStore:
    return ModelStore(tmp_path / "models", tmp_path / "shipped")


@pytest.fixture
def publish(tmp_path: Path, store: ModelStore) -> Publish:
    def publish(weights: str, name: str = "", where: ModelStore = store) -> ModelRef:
        folder = tmp_path / "unpublished"
        folder.mkdir(exist_ok=True)
        (folder / "weights").write_text(weights)
        (folder / "card.json").write_text(json.dumps({"weights": weights}))
        return where.publish(name, folder)

    return publish


class Loader:
    """Loads a model as its text, and remembers what it loaded."""

    def __init__(self) -> None:
        self.loaded: list[str] = []

    def __call__(self, folder: Path) -> str:
        weights = (folder / "weights").read_text()
        if weights == "malformed":
            raise InvalidInput("A card must be one; it is not.")
        self.loaded.append(weights)
        return weights


@pytest.fixture
def loader() -> Loader:
    return Loader()


@pytest.fixture
def models(store: ModelStore, loader: Loader) -> ModelCache[str]:
    return ModelCache(store, loader, fit_command="freerein fit toy")


def test_the_same_files_have_the_same_version_and_others_another(store: ModelStore, publish: Publish) -> None:
    first, again, other = publish("a"), publish("a"), publish("b")
    assert first == again != other
    assert first.name == "default"
    assert len(first.version) == 12
    assert len(store.models()) == 2


def test_a_publication_that_broke_off_is_made_again(store: ModelStore, publish: Publish, tmp_path: Path) -> None:
    whole = publish("a")
    (tmp_path / "unpublished").mkdir()
    (tmp_path / "unpublished" / "manifest.json.tmp").write_text("{")
    assert publish("a", "another").version == whole.version
    assert store.folder(ModelRef("another", whole.version))


def test_what_is_published_is_gone_from_where_it_was_and_not_active_yet(
    tmp_path: Path, store: ModelStore, publish: Publish
) -> None:
    ref = publish("a")
    assert not (tmp_path / "unpublished").exists()
    assert store.active_version("default") == ""
    store.activate(ref)
    assert store.active_version("default") == ref.version


def test_models_are_listed_by_name_with_their_cards_and_which_is_active(store: ModelStore, publish: Publish) -> None:
    store.activate(publish("a", "zebra"))
    publish("b", "ape")
    listed = [(model.ref.name, model.active, model.card) for model in store.models()]
    assert listed == [("ape", False, {"weights": "b"}), ("zebra", True, {"weights": "a"})]


def test_what_came_with_freerein_is_found_after_what_was_fitted(
    tmp_path: Path, store: ModelStore, publish: Publish
) -> None:
    shipped = ModelStore(tmp_path / "shipped")
    theirs = publish("theirs", where=shipped)
    shipped.activate(theirs)
    assert store.active_version("default") == theirs.version
    ours = publish("ours")
    store.activate(ours)
    assert store.active_version("default") == ours.version
    store.activate(theirs)
    assert store.active_version("default") == theirs.version
    assert not (tmp_path / "shipped" / "default" / ours.version).exists()


def test_a_model_has_the_time_of_its_publication_and_one_that_came_with_freerein_none(
    tmp_path: Path, store: ModelStore, publish: Publish
) -> None:
    publish("a", "theirs", where=ModelStore(tmp_path / "shipped"))
    ours = publish("b", "ours")
    times_ns = {model.ref.name: model.time_ns for model in store.models()}
    assert times_ns == {"ours": (tmp_path / "models" / "ours" / ours.version).stat().st_mtime_ns, "theirs": 0}


@pytest.mark.parametrize("damage", ["flip", "shorten", "delete", "manifest", "no manifest"])
def test_a_damaged_model_is_refused(store: ModelStore, publish: Publish, damage: str) -> None:
    ref = publish("weights")
    folder = store.folder(ref)
    if damage == "flip":
        (folder / "weights").write_text("Weights")
    elif damage == "shorten":
        (folder / "weights").write_text("weight")
    elif damage == "delete":
        (folder / "weights").unlink()
    elif damage == "manifest":
        (folder / "manifest.json").write_text('{"files": {}}')
    else:
        (folder / "manifest.json").unlink()
    with pytest.raises(NotFound if damage == "no manifest" else FailedPrecondition) as error:
        store.folder(ref)
    assert str(folder) not in error.value.detail
    if damage == "no manifest":  # files are checked where they are loaded
        with pytest.raises(NotFound):
            store.activate(ref)


@pytest.mark.parametrize("name", ["../x", "..", "", "/etc", "a/b", "A", "a\0b", "é", "a" * 65, ".hidden"])
def test_a_name_is_no_path(store: ModelStore, name: str) -> None:
    for ref in (ModelRef(name, "0" * 12), ModelRef("default", name)):
        with pytest.raises(InvalidInput):
            store.folder(ref)


def test_another_version_than_expected_is_not_replaced(store: ModelStore, publish: Publish) -> None:
    first, second, third = publish("a"), publish("b"), publish("c")
    store.activate(first, expected_current="")
    store.activate(second, expected_current=first.version)
    with pytest.raises(FailedPrecondition, match=second.version):
        store.activate(third, expected_current=first.version)
    assert store.active_version("default") == second.version


def test_of_replicas_that_replace_one_version_at_once_one_does(tmp_path: Path, publish: Publish) -> None:
    first, *others = (publish(text) for text in "abcdefghi")
    ModelStore(tmp_path / "models").activate(first)
    all_are_there = threading.Barrier(len(others))

    def replace(ref: ModelRef) -> str:
        replica = ModelStore(tmp_path / "models")
        all_are_there.wait(60)
        try:
            replica.activate(ref, expected_current=first.version)
        except FailedPrecondition:
            return ""
        return ref.version

    with ThreadPoolExecutor(len(others)) as threads:
        (done,) = filter(None, threads.map(replace, others))
    assert ModelStore(tmp_path / "models").active_version("default") == done


def test_a_version_that_is_deleted_while_its_activation_waits_is_not_activated(
    store: ModelStore, publish: Publish, monkeypatch: pytest.MonkeyPatch
) -> None:
    ref, _ = publish("a"), publish("b")

    @contextmanager
    def held_by_a_deletion() -> Iterator[None]:
        monkeypatch.undo()
        store.delete([ref])
        yield

    monkeypatch.setattr(store, "_changing", held_by_a_deletion)
    with pytest.raises(NotFound):
        store.activate(ref)
    assert store.active_version("default") == ""


@pytest.mark.parametrize("asked", ["models", "active version", "folder"])
def test_a_version_that_is_deleted_while_it_is_read_is_not_there(
    store: ModelStore, publish: Publish, monkeypatch: pytest.MonkeyPatch, asked: str
) -> None:
    refs = [publish("a"), publish("b")]
    store.activate(refs[0])
    read_bytes = Path.read_bytes

    def deleted_first(path: Path) -> bytes:
        monkeypatch.undo()
        store.delete(refs, even_active=True)
        return read_bytes(path)

    monkeypatch.setattr(Path, "read_bytes", deleted_first)
    if asked == "folder":
        with pytest.raises(NotFound):
            store.folder(refs[0])
    else:
        assert not (store.models() if asked == "models" else store.active_version("default"))


async def test_the_active_model_is_loaded_before_it_is_ready_and_once(
    store: ModelStore, publish: Publish, models: ModelCache[str], loader: Loader
) -> None:
    ref = publish("a")
    publish("b")
    store.activate(ref)
    assert models.not_ready()
    await models.start()
    assert not models.not_ready()
    assert await models.resolve(ModelRef()) == (ref, "a")
    assert await models.resolve(ref) == (ref, "a")
    assert loader.loaded == ["a"]


async def test_a_disk_that_hangs_holds_up_no_call_that_names_a_model_in_memory(
    store: ModelStore, publish: Publish, models: ModelCache[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    ref, reading, goes_on, read_bytes = publish("a"), threading.Event(), threading.Event(), Path.read_bytes
    store.activate(ref)
    await models.start()

    def hang(path: Path) -> bytes:
        reading.set()
        assert goes_on.wait(60)
        return read_bytes(path)

    monkeypatch.setattr(Path, "read_bytes", hang)
    held_up = asyncio.create_task(models.resolve(ModelRef()))
    assert await asyncio.to_thread(reading.wait, 60)
    assert await models.resolve(ref) == (ref, "a")
    goes_on.set()
    assert await held_up == (ref, "a")


async def test_without_a_model_it_is_ready_and_says_how_to_get_one(models: ModelCache[str]) -> None:
    await models.start()
    assert not models.not_ready()
    with pytest.raises(FailedPrecondition) as error:
        await models.resolve(ModelRef())
    assert error.value.hint == "Fit one: freerein fit toy"


async def test_a_call_that_names_no_active_model_is_told_which_are(
    store: ModelStore, publish: Publish, models: ModelCache[str]
) -> None:
    store.activate(publish("a", "x"))
    publish("b", "inactive")
    with pytest.raises(FailedPrecondition) as error:
        await models.resolve(ModelRef())
    assert error.value.hint == "Name an active one: x. Or fit one: freerein fit toy"


async def test_any_version_can_be_asked_for_by_name(publish: Publish, models: ModelCache[str]) -> None:
    first, second = publish("a", "x"), publish("b", "x")
    assert [(await models.resolve(ref))[1] for ref in (first, second)] == ["a", "b"]
    with pytest.raises(NotFound):
        await models.resolve(ModelRef("x", "0" * 12))


async def test_activating_swaps_what_answers_and_returns_it(publish: Publish, models: ModelCache[str]) -> None:
    first, second = publish("a"), publish("b")
    await models.activate_model(ActivateModelRequest("", first.version))
    assert (await models.resolve(ModelRef()))[1] == "a"
    reply = await models.activate_model(ActivateModelRequest("", second.version, first.version))
    assert (reply.model.ref, reply.model.active) == (second, True)
    assert (await models.resolve(ModelRef()))[1] == "b"
    assert [model.active for model in (await models.list_models(ListModelsRequest())).models].count(True) == 1


async def test_a_damaged_model_is_not_activated_and_the_old_one_stays(
    store: ModelStore, publish: Publish, models: ModelCache[str]
) -> None:
    first, second, third = publish("a"), publish("b"), publish("c")
    await models.activate_model(ActivateModelRequest("", first.version))
    (store.folder(second) / "weights").write_text("e")
    with pytest.raises(FailedPrecondition):
        await models.activate_model(ActivateModelRequest("", second.version))
    assert (await models.resolve(ModelRef()))[1] == "a"
    await models.resolve(third)
    (store.folder(third) / "weights").write_text("d")
    with pytest.raises(FailedPrecondition):  # although it is in memory as it was
        await models.activate_model(ActivateModelRequest("", third.version))
    assert store.active_version("default") == first.version


async def test_a_damaged_active_model_stops_the_start(
    store: ModelStore, publish: Publish, models: ModelCache[str]
) -> None:
    ref = publish("a")
    store.activate(ref)
    folder = store.folder(ref)
    (folder / "weights").write_text("b")
    with pytest.raises(FailedPrecondition, match=ref.version):
        await models.start()
    shutil.rmtree(folder)
    with pytest.raises(FailedPrecondition, match=f"{ref.version}.*is gone"):
        await models.start()


async def test_an_active_model_of_another_format_is_refused_where_it_is_named_and_the_others_are_served(
    store: ModelStore, publish: Publish, models: ModelCache[str]
) -> None:
    old, other = publish("malformed", "old"), publish("a")
    store.activate(old)
    store.activate(other)
    await models.start()
    assert not models.not_ready()
    assert await models.resolve(ModelRef()) == (other, "a")
    with pytest.raises(InvalidInput, match="card"):
        await models.resolve(ModelRef("old"))


@pytest.mark.parametrize(
    ("name", "version", "field"), [("", "", "version"), ("", "../x", "version"), ("../x", "0" * 12, "name")]
)
async def test_a_wrong_request_is_refused_by_its_field(
    models: ModelCache[str], name: str, version: str, field: str
) -> None:
    with pytest.raises(InvalidInput) as error:
        await models.activate_model(ActivateModelRequest(name, version))
    assert error.value.field == field


async def test_only_the_models_used_last_are_kept(publish: Publish, models: ModelCache[str], loader: Loader) -> None:
    refs = [publish(text) for text in "abcde"]
    for ref in (*refs, refs[4], refs[0]):
        await models.resolve(ref)
    assert "".join(loader.loaded) == "abcdea"


async def test_active_models_are_never_evicted(
    store: ModelStore, publish: Publish, models: ModelCache[str], loader: Loader
) -> None:
    active = [publish(name, name) for name in "abcdef"]
    for ref in active:
        store.activate(ref)
    await models.start()
    for text in "uvwxyz":
        await models.resolve(publish(text, "other"))
    assert [(await models.resolve(ModelRef(ref.name)))[1] for ref in active] == list("abcdef")
    assert "".join(loader.loaded) == "abcdefuvwxyz"


async def test_a_model_that_is_no_longer_active_can_be_evicted(
    publish: Publish, models: ModelCache[str], loader: Loader
) -> None:
    refs = [publish(text) for text in "abcdef"]
    for ref in refs:
        await models.activate_model(ActivateModelRequest("", ref.version))
    await models.resolve(refs[0])
    assert "".join(loader.loaded) == "abcdefa"


async def test_a_load_whose_first_caller_gave_up_is_that_of_the_next(store: ModelStore, publish: Publish) -> None:
    begun, may_end, loads = threading.Event(), threading.Event(), list[str]()

    def load(folder: Path) -> str:
        loads.append(folder.name)
        begun.set()
        assert may_end.wait(10)
        return folder.name

    ref, models = publish("a"), ModelCache(store, load, fit_command="freerein fit toy")
    first = asyncio.create_task(models.resolve(ref))
    assert await asyncio.to_thread(begun.wait, 10)
    first.cancel()
    with pytest.raises(asyncio.CancelledError):
        await first
    second = asyncio.create_task(models.resolve(ref))
    may_end.set()
    assert await second == (ref, ref.version)
    assert loads == [ref.version]
