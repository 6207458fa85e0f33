"""Models on disk: `<root>/<name>/<version>/` with a manifest; `<root>/<name>/active.json` names the active version.

The manifest holds the sha256 of every file, and a version is the first 12 hexadecimal digits of the manifest's sha256,
so a version is immutable. Models are published by one rename, and their files are checked before they are loaded.
"""

import errno
import hashlib
import json
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from freerein.atomic_files import TEMP_SUFFIX, delete_folder, fsync_folder, locked, make_folder, write_atomic
from freerein.errors import FailedPrecondition, NotFound
from freerein.types.common import ModelRef, check_name
from freerein.types.learning import Model

DEFAULT_NAME = "default"
MANIFEST = "manifest.json"
CARD = "card.json"
CLONE_MODELS = Path(__file__).parents[2] / "models"
"""Default folder of the shipped models."""


class ModelStore:
    """The models of one service: those published to `root`, then the read-only `shipped` ones."""

    def __init__(self, root: Path, shipped: Path | None = None) -> None:
        self._root = root
        self._roots = (root, shipped) if shipped is not None else (root,)

    def publish(self, name: str, folder: Path) -> ModelRef:
        """Moves a folder of files into the store and returns its reference. Equal files have equal versions.

        Args:
            name: The model's name; empty for the default one.
            folder: The files, among them `card.json`; moved or removed.
        """
        name = check_name(name or DEFAULT_NAME, field="model_name")
        paths = (path for path in sorted(folder.iterdir()) if path.name.removesuffix(TEMP_SUFFIX) != MANIFEST)
        files = {path.name: _sha256(path) for path in paths}
        manifest = json.dumps({"files": files}, sort_keys=True).encode()
        version = hashlib.sha256(manifest).hexdigest()[:12]
        write_atomic(folder / MANIFEST, manifest)
        target = self._root / name / version
        with self._changing():
            make_folder(target.parent)
            try:
                folder.rename(target)
            except OSError as error:
                if error.errno not in (errno.EEXIST, errno.ENOTEMPTY):
                    raise
                shutil.rmtree(folder)  # the same files are there already
            fsync_folder(target.parent)
        return ModelRef(name, version)

    def activate(self, ref: ModelRef, *, expected_current: str = "") -> None:
        """Makes a version the active one. Its files are checked when they are loaded, not here.

        Raises:
            NotFound: The model does not exist.
            FailedPrecondition: The active version is not `expected_current`.
        """
        with self._changing():
            self._find(ref)
            current = self.active_version(ref.name)
            if expected_current and expected_current != current:
                raise FailedPrecondition(
                    f"The active version must be the expected one; it is {current or 'none'}.",
                    field="expected_current",
                    hint="List the models, decide again, and send the version that is active now.",
                )
            write_atomic(self._root / ref.name / "active.json", json.dumps({"version": ref.version}).encode())

    def published(self, name: str, version: str = "") -> tuple[ModelRef, ...]:
        """Returns a version, or all of a name, without those that came with freerein.

        Raises:
            NotFound: There is none.
            FailedPrecondition: All of them came with freerein.
        """
        check_name(name, field="name")
        if version:
            check_name(version, field="version")
        folders = [path for path in _folders(self._root / name) if (path / MANIFEST).is_file()]
        if found := sorted(path.name for path in folders if version in ("", path.name)):
            return tuple(ModelRef(name, each) for each in found)
        if any(model.ref.name == name and version in ("", model.ref.version) for model in self.models()):
            raise FailedPrecondition(
                "A model to delete must have been published here; this one comes with freerein.",
                field="name",
                hint="Those that come with freerein stay.",
            )
        raise _not_found(field="name")

    def delete(self, refs: Sequence[ModelRef], *, even_active: bool = False) -> None:
        """Deletes published versions of one name.

        Raises FailedPrecondition, and deletes nothing, where one is active, unless `even_active`.
        """
        with self._changing():
            for ref in refs:
                if self.active_version(ref.name) == ref.version:
                    if not even_active:
                        raise _is_active(ref)
                    (self._root / ref.name / "active.json").unlink(missing_ok=True)
                    fsync_folder(self._root / ref.name)
            for ref in refs:
                delete_folder(self._root / ref.name / ref.version)
                with suppress(OSError):  # other versions are left
                    (self._root / ref.name).rmdir()

    def active_version(self, name: str) -> str:
        """Returns the active version of a name, empty when there is none."""
        for root in self._roots:
            path = root / name / "active.json"
            with suppress(FileNotFoundError):  # deleted meanwhile
                if path.is_file():
                    return _version(path)
        return ""

    def names(self) -> tuple[str, ...]:
        """Returns the names of all models."""
        return tuple(sorted({path.name for root in self._roots for path in _folders(root)}))

    def models(self) -> tuple[Model, ...]:
        """Returns every version of every model, sorted by name, newest version first."""
        found: dict[ModelRef, Model] = {}
        for folder in (folder for root in self._roots for folder in _folders(root)):
            for path in _newest_first(folder):
                ref = ModelRef(folder.name, path.name)
                active = self.active_version(ref.name) == ref.version
                with suppress(FileNotFoundError):  # deleted meanwhile
                    found.setdefault(ref, Model(ref, active, model_card(path), self.published_ns(path)))
        return tuple(sorted(found.values(), key=lambda model: model.ref.name))  # stable: newest first within a name

    def folder(self, ref: ModelRef) -> Path:
        """Returns the folder of a version after checking every file against the manifest.

        Raises NotFound when the model does not exist, FailedPrecondition when a file is missing or changed.
        """
        folder = self._find(ref)
        try:
            is_intact = _is_intact(folder)
        except FileNotFoundError:  # deleted meanwhile
            raise _not_found(field="model") from None
        if not is_intact:
            raise FailedPrecondition(
                f"The files of model {ref.name} {ref.version} must match its manifest; one is missing or changed.",
                field="model",
                hint="Activate another version, or fit the model again.",
            )
        return folder

    def published_ns(self, folder: Path) -> int:
        """Returns when the version in a folder was published, Unix time in nanoseconds; 0 for a shipped one."""
        return folder.stat().st_mtime_ns if folder.is_relative_to(self._root) else 0

    @contextmanager
    def _changing(self) -> Iterator[None]:
        """Keeps others from changing the store: threads of this service, of its replicas and of its fits."""
        make_folder(self._root)
        with locked(self._root / ".lock"):
            yield

    def _find(self, ref: ModelRef) -> Path:
        check_name(ref.name, field="model.name")
        check_name(ref.version, field="model.version")
        for root in self._roots:
            path = root / ref.name / ref.version
            if (path / MANIFEST).is_file():
                return path
        raise _not_found(field="model")


def _not_found(*, field: str) -> NotFound:
    return NotFound(
        "The model must exist in the store; none has that name and version.",
        field=field,
        hint="GET /v1/list-models lists them.",
    )


def _is_active(ref: ModelRef) -> FailedPrecondition:
    return FailedPrecondition(
        f"A model to delete must not be active; version {ref.version} of {ref.name} answers requests.",
        field="version",
        hint="Activate another version first; or ask for `even_active`, with `freerein models rm` by --active.",
    )


def model_card(folder: Path) -> dict[str, Any]:
    """Returns a model's card."""
    return dict(json.loads((folder / CARD).read_bytes()))


def _version(path: Path) -> str:
    try:
        return str(json.loads(path.read_bytes())["version"])
    except (ValueError, KeyError, TypeError):
        raise FailedPrecondition(
            f"The record of the active version of {path.parent.name} must be valid JSON; it is damaged.",
            field="model",
            hint="Delete its active.json and activate a version again.",
        ) from None


def _is_intact(folder: Path) -> bool:
    manifest = (folder / MANIFEST).read_bytes()
    return hashlib.sha256(manifest).hexdigest().startswith(folder.name) and all(
        (folder / name).is_file() and _sha256(folder / name) == digest
        for name, digest in json.loads(manifest)["files"].items()
    )


def _newest_first(folder: Path) -> list[Path]:
    """Returns the folders of the versions of a model."""
    dated = []
    for path in _folders(folder):
        with suppress(FileNotFoundError):  # deleted meanwhile
            if (path / MANIFEST).is_file():
                dated.append((path.stat().st_mtime_ns, path))
    return [path for _, path in sorted(dated, reverse=True)]


def _folders(path: Path) -> Iterator[Path]:
    """Yields the folders in a folder, without hidden ones, which are being deleted."""
    with suppress(FileNotFoundError):  # deleted meanwhile
        found = path.iterdir() if path.is_dir() else iter(())
        yield from (entry for entry in found if entry.is_dir() and not entry.name.startswith("."))


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
