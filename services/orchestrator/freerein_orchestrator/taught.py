"""Policies to begin with: what other runs left behind, and what came with freerein or was published."""

import re
from pathlib import Path

from freerein.errors import InvalidInput, NotFound
from freerein.serving.models import IN_A_CLONE, ModelStore
from freerein.types.common import ModelRef, check_name
from freerein_orchestrator import policy_artifact
from freerein_orchestrator.networks import ActorCritic, ActorCriticSpec
from freerein_orchestrator.work import Work

_ID = re.compile(r"[0-9a-f]{32}")


def taught_policy(work: Work, name: str, spec: ActorCriticSpec) -> ActorCritic:
    """Returns the network of a policy that another one is to begin with.

    Args:
        work: The run that is to begin.
        name: A run's id, the name of an earlier step of the same pipeline, or a policy's name among the models.
        spec: What the new policy sees and does.

    Raises:
        InvalidInput: There is no such policy, or it sees or does something else.
    """
    network = policy_artifact.load(policy_folder(work, name, field="config.start_from"), device="cpu").network
    if network.spec != spec:
        raise InvalidInput(
            f"A policy to start from must see, do and be as large as the new one: {spec}; it is {network.spec}.",
            field="config.start_from",
            hint="Choose the task, features, hidden and is_recurrent that it was trained with.",
        )
    return network


def policy_folder(work: Work, name: str, *, field: str) -> Path:
    """Returns the folder of a policy, for `policy_artifact.load`.

    Args:
        work: The run that is to build on it.
        name: A run's id, the name of an earlier step of the same pipeline, or a policy's name among the models.
        field: The configuration's, where the name stands.

    Raises:
        InvalidInput: There is none of that name.
    """
    check_name(name, field=field)
    store = ModelStore(work.data_dir / "models" / "orchestrator", shipped=_shipped(work) / "orchestrator")
    version = "" if _ID.fullmatch(name) else store.active_version(name)
    if not version:
        return work.run_folder(name) / "artifacts"
    try:
        return store.folder(ModelRef(name, version))
    except NotFound as error:
        raise InvalidInput(error.detail, field=field, hint=error.hint) from error


def _shipped(work: Work) -> Path:
    told = work.environ.get("FREEREIN_SHIPPED_DIR", "")
    return Path(told) if told else IN_A_CLONE
