"""The training of a ppo run that has succeeded, which another ppo run goes on with."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import cast

from freerein.errors import FailedPrecondition, InvalidInput
from freerein.learning import checkpoints
from freerein.learning.actor_critic.policy_files import NAMES
from freerein.learning.checkpoints import JSON, Checkpoint
from freerein_orchestrator.kinds.policy_store import PolicyStore, no_policy
from freerein_orchestrator.rl.config import PPOConfig

_OWN = {"iterations", "init_from", "resume_from", "threads"}
_UPDATE = {"lr", "gamma", "gae_lambda", "clip_range", "ent_coef", "vf_coef", "init_log_std", "final_log_std"}
_FREE = {*_OWN, *_UPDATE, "approach_weight", "carry_weight"}
"""Keys of the configuration that shape no state."""


def find_training(store: PolicyStore, name: str, config: PPOConfig, *, field: str) -> Checkpoint:
    """Returns the newest intact checkpoint of a run's training.

    Args:
        store: Finds the run.
        name: The run's id, or the name of an earlier step of the same pipeline.
        config: Of the run that goes on with it.
        field: The configuration's field that holds the name.

    Raises:
        InvalidInput: There is no such run, it has trained no policy, or its configuration is another.
        FailedPrecondition: Its checkpoints are gone.
    """
    folder = store.run_folder(name, field=field)
    if not (folder / "artifacts" / NAMES.card).is_file():
        raise no_policy(field=field, hint="Name a ppo run that has succeeded; resume one that failed or was cancelled.")
    checkpoint = checkpoints.newest(folder / "checkpoints", on_corrupt=lambda *_: None)
    if checkpoint is None:
        raise FailedPrecondition(
            "A run to go on with must have an intact checkpoint; this one has none left.",
            field=field,
            hint="`init_from` begins a new training with its policy.",
        )
    _check_same(cast(Mapping[str, Mapping[str, JSON]], checkpoint.document["identity"])["config"], config)
    return checkpoint


def check_sims(checkpoint: Checkpoint, sims: int) -> None:
    """Raises FailedPrecondition where a training ran over another number of sim services: each has its environments."""
    inputs = cast(Mapping[str, Mapping[str, JSON]], checkpoint.document["identity"])["inputs"]
    if inputs["sims"] != sims:
        raise FailedPrecondition(
            f"A training goes on over as many sim services as it had; they were {inputs['sims']} and are {sims}.",
            hint="Restore FREEREIN_SIM_ADDRESS.",
        )


def _check_same(then: Mapping[str, JSON], config: PPOConfig) -> None:
    now: Mapping[str, JSON] = json.loads(json.dumps(asdict(config)))
    changed = [name for name in now if name in then and name not in _FREE and then[name] != now[name]]
    if (then["final_log_std"] is None) != (now["final_log_std"] is None):
        changed.append("final_log_std")
    if changed:
        changes = ", ".join(f"{name} was {json.dumps(then[name])} and is {json.dumps(now[name])}" for name in changed)
        raise InvalidInput(
            f"A run that goes on with another must have its configuration; {changes}.",
            field=f"config.{changed[0]}",
            hint="`freerein jobs resume ID --iterations N` takes it over. `init_from` begins a new training.",
        )
