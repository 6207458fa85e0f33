"""Policies to build on: what other runs left behind, and what came with freerein or was published."""

import json
import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from freerein.atomic_files import write_atomic
from freerein.errors import InvalidInput, NotFound
from freerein.serving.model_store import CLONE_MODELS, ModelStore
from freerein.types.common import ModelRef, check_name
from freerein_orchestrator import policy_artifact
from freerein_orchestrator.networks import ActorCriticSpec
from freerein_orchestrator.policy_artifact import Policy
from freerein_orchestrator.work import Work

_ID = re.compile(r"[0-9a-f]{32}")


def taught_policy(work: Work, name: str, spec: ActorCriticSpec) -> Policy:
    """Returns the policy that another one is to begin with.

    Args:
        work: The run that is to begin.
        name: A run's id, the name of an earlier step of the same pipeline, or a policy's name among the models.
        spec: What the new policy sees and does.

    Raises:
        InvalidInput: There is no such policy, or it sees or does something else.
    """
    policy = policy_artifact.load(policy_folder(work, name, field="config.start_from"), device="cpu")
    if policy.network.spec != spec:
        raise InvalidInput(
            f"A policy to start from must see, do and be as large as the new one: {spec}; it is {policy.network.spec}.",
            field="config.start_from",
            hint="Choose the task, features, hidden and is_recurrent that it was trained with.",
        )
    return policy


def policy_folder(work: Work, name: str, *, field: str) -> Path:
    """Returns the folder of a policy, for `policy_artifact.load`.

    Args:
        work: The run that is to build on it.
        name: A run's id, the name of an earlier step of the same pipeline, or a policy's name among the models: of the
            version that is pinned, or else active.
        field: The configuration's, where the name stands.

    Raises:
        InvalidInput: There is none of that name.
    """
    check_name(name, field=field)
    version = _pinned(work).get(name) or _active_version(work, name)
    if not version:
        return work.run_folder(name) / "artifacts"
    try:
        return _store(work).folder(ModelRef(name, version))
    except NotFound as error:
        raise InvalidInput(error.detail, field=field, hint=error.hint) from error


def pin(work: Work, names: Iterable[str]) -> None:
    """Notes, durably and once, which versions of models are active: later attempts at the work mean the same ones."""
    if not _pins(work).is_file():
        write_atomic(_pins(work), json.dumps({name: _active_version(work, name) for name in names}).encode())


def _active_version(work: Work, name: str) -> str:
    """Returns the active version of a model, empty for the name of a run or of an earlier step, which goes first."""
    is_run = _ID.fullmatch(name) or (work.folder.parent / name).is_dir()
    return "" if is_run else _store(work).active_version(name)


def _pinned(work: Work) -> Mapping[str, str]:
    return dict(json.loads(_pins(work).read_bytes())) if _pins(work).is_file() else {}


def _pins(work: Work) -> Path:
    return work.folder / "checkpoints" / "pinned.json"


def _store(work: Work) -> ModelStore:
    told = work.environ.get("FREEREIN_SHIPPED_DIR", "")
    shipped = Path(told) if told else CLONE_MODELS
    return ModelStore(work.data_dir / "models" / "orchestrator", shipped=shipped / "orchestrator")
