"""Policies and runs that a run may build on: other runs, earlier steps of its pipeline, and stored models."""

import json
import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from freerein.atomic_files import write_atomic
from freerein.errors import InvalidInput, NotFound, quoted
from freerein.jobs.json_lines import last_document
from freerein.learning.actor_critic.policy_files import NAMES, StoredPolicy, load_policy
from freerein.learning.model_files import read_card
from freerein.model_store import CLONE_MODELS, ModelStore
from freerein.types.common import ModelRef, check_name

_RUN_ID = re.compile(r"[0-9a-f]{32}")
_FIRST_DIGITS = re.compile(r"[0-9a-f]{6,31}")


@dataclass(frozen=True)
class PolicyStore:
    """Finds policies and runs by name.

    Attributes:
        runs: Folder of all runs.
        models: Policies that were published, and those that came with freerein.
        siblings: Folder of the steps of the same pipeline; None outside one.
        pins: File that pins names to versions of models.
    """

    runs: Path
    models: ModelStore
    siblings: Path | None = None
    pins: Path | None = None

    @classmethod
    def open(
        cls, data_dir: Path, environ: Mapping[str, str], *, siblings: Path | None = None, pins: Path | None = None
    ) -> "PolicyStore":
        """Returns the store of a data directory; `FREEREIN_SHIPPED_DIR` says where shipped models are."""
        shipped = Path(environ.get("FREEREIN_SHIPPED_DIR") or CLONE_MODELS).expanduser()
        models = ModelStore(data_dir / "models" / "orchestrator", shipped=shipped / "orchestrator")
        return cls(data_dir / "runs", models, siblings, pins)

    def load(self, name: str, *, field: str, device: str = "cpu") -> StoredPolicy:
        """Returns a policy.

        Args:
            name: A run's id, an earlier step of the pipeline, or a stored policy: its pinned, else its active version.
            field: The configuration's field that holds the name.
            device: `auto`, `cpu` or `cuda:N`.

        Raises:
            InvalidInput: There is none of that name, or the run has not made one.
        """
        return load_policy(self.folder(name, field=field), device=device)

    def folder(self, name: str, *, field: str) -> Path:
        """Returns a policy's folder; arguments and errors as of `load`."""
        check_name(name, field=field)
        version = self._pinned().get(name) or self._active_version(name)
        if version:
            return self.model_folder(ModelRef(name, version), field=field)
        folder = self.run_folder(name, field=field) / "artifacts"
        if not (folder / NAMES.card).is_file():
            raise no_policy(field=field, hint="Name a ppo run that has succeeded.")
        return folder

    def privileged_supervision(self, name: str) -> str:
        """Returns the supervision of a policy that is privileged; empty for another, and where there is none."""
        try:
            card = read_card(self.folder(name, field="policy"), names=NAMES)
        except InvalidInput:
            return ""
        return str(card["supervision"]) if card.get("privileged") is True else ""

    def model_folder(self, ref: ModelRef, *, field: str) -> Path:
        """Returns the folder of a stored policy; without a version, of its active one.

        Raises:
            InvalidInput: There is no such policy.
        """
        try:
            return self.models.folder(self.resolve_model(ref, field=field))
        except NotFound as error:
            raise InvalidInput(error.detail, field=field, hint=error.hint) from error

    def resolve_model(self, ref: ModelRef, *, field: str) -> ModelRef:
        """Returns a stored policy with its version, by default the active one.

        Raises:
            InvalidInput: No version was named and none is active.
        """
        version = ref.version or self.models.active_version(check_name(ref.name, field=field))
        if not version:
            raise InvalidInput(
                "The policy must be a stored one with an active version; no version of that name is active.",
                field=field,
                hint="Name a version, or one of the models of the orchestrator.",
            )
        return ModelRef(ref.name, version)

    def run_folder(self, name: str, *, field: str) -> Path:
        """Returns the folder of a run, by its id, or of an earlier step of the same pipeline, by its name.

        The first digits of the id, six or more, will do, or a readable name, which ends with them.

        Raises:
            InvalidInput: There is neither.
        """
        check_name(name, field=field)
        for parent in (self.siblings, self.runs):
            if parent is not None and (parent / name).is_dir():
                return parent / name
        digits = name.rpartition("-")[2]
        found = list(self.runs.glob(f"{digits}*/config.json")) if _FIRST_DIGITS.fullmatch(digits) else []
        if len(found) == 1:
            return found[0].parent
        raise InvalidInput(
            f"A run to build on must exist, or be an earlier step of the pipeline; got {quoted(name)}.",
            field=field,
            hint="`freerein jobs list` names the runs.",
        )

    def pin(self, names: Iterable[str]) -> None:
        """Pins, durably and once, the active versions of models: later attempts at the run use the same ones."""
        if self.pins is not None and not self.pins.is_file():
            write_atomic(self.pins, json.dumps({name: self._active_version(name) for name in names}).encode())

    def _active_version(self, name: str) -> str:
        """Returns a model's active version; empty for the names of runs and earlier steps, which take precedence."""
        is_run = _RUN_ID.fullmatch(name) or (self.siblings is not None and (self.siblings / name).is_dir())
        return "" if is_run else self.models.active_version(name)

    def _pinned(self) -> Mapping[str, str]:
        return dict(json.loads(self.pins.read_bytes())) if self.pins is not None and self.pins.is_file() else {}


def is_step(name: str, earlier: Mapping[str, str], kinds: Collection[str] = ("ppo",), *, field: str) -> bool:
    """Returns whether a name is that of an earlier step of the same pipeline.

    Args:
        name: The name.
        earlier: The kind of each earlier step, by name; of a fit, with the service that has its model.
        kinds: Kinds of steps that make what is needed.
        field: The configuration's field that holds the name.

    Raises:
        InvalidInput: It is a step of another kind.
    """
    if name in earlier and earlier[name] not in kinds:
        raise InvalidInput(
            f"A step to build on must be of the kind {' or '.join(kinds)}; {name} is of the kind {earlier[name]}.",
            field=field,
            hint="Name another step, or the id of a run.",
        )
    return name in earlier


def has_succeeded(run_folder: Path) -> bool:
    """Returns whether a run, by its folder, has succeeded."""
    events = run_folder / "events.jsonl"
    last = last_document(events) if events.is_file() else None
    return last is not None and last["state"] == "succeeded"


def no_policy(*, field: str, hint: str) -> InvalidInput:
    """Returns the error of a run that has made no policy: it failed, goes on, or is of another kind."""
    return InvalidInput("The run must have made a policy; this one has not.", field=field, hint=hint)
