"""Kind `distill`: one policy that is told in words what to do, from policies that know one task each.

The teachers' rollouts become a dataset, each with its goal text; the imitation service clones what they did.

    <folder>/rollouts/                the dataset while it is recorded, which then becomes `<data>/datasets/<name>`
             artifacts/dataset.json   its name, size and fingerprint, once it is whole
             parts/fit/               the fit, as kind `fit`
"""

import errno
import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import torch

from freerein.atomic_files import fsync_folder, write_atomic
from freerein.data import Dataset, dataset_path, save_teachers
from freerein.errors import AlreadyExists, InvalidInput
from freerein.learning.config import bounded, parse
from freerein.types.common import check_name
from freerein_orchestrator import policy_artifact, taught
from freerein_orchestrator.bearings import Bearing, check_alike
from freerein_orchestrator.kinds import fit, lessons
from freerein_orchestrator.kinds.collect import CARD
from freerein_orchestrator.kinds.kind import Kind
from freerein_orchestrator.kinds.lessons import Keep, Schedule
from freerein_orchestrator.patience import Patience, Stopped
from freerein_orchestrator.policy_artifact import Policy
from freerein_orchestrator.work import Work

_TORCH_THREADS = 1
_TOLD = ("task", "goal_text", "reward", "supervision", "privileged", "sha256")


@dataclass(frozen=True)
class DistillConfig:
    """Whom to learn from, and how.

    Attributes:
        teachers: The policies: ids of ppo runs, names of earlier steps of the same pipeline, or of policies among the
            models of the orchestrator. Each says in its card what it was to do, and in which task.
        rollouts: Episodes of each teacher; the dissertation has 50 (4.3).
        num_envs: Environments that step together.
        is_stochastic: Whether teachers' actions are drawn from their policies; else the likeliest is taken.
        keep: `all` rollouts, as in the dissertation, or those in whose last frame the model that rewarded their teacher
            sees the goal.
        seed: Of every episode.
        dataset: Name for the dataset of rollouts; empty for the run's id.
        model_name: Name for the student.
        config: Of the fit of a language policy; what is left out has its default in the imitation service.

    Raises:
        InvalidInput: There is no teacher, or the fit is not to be of a language policy, or its steps, or a name, are
            none.
    """

    teachers: tuple[str, ...]
    rollouts: int = bounded(50, least=1, most=100_000)
    num_envs: int = bounded(10, least=1, most=64)
    is_stochastic: bool = False
    keep: Keep = "all"
    seed: int = bounded(0, least=0, most=2**31 - 1)
    dataset: str = ""
    model_name: str = "language"
    config: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.teachers:
            raise InvalidInput(
                "There must be a teacher at least; got none.",
                field="config.teachers",
                hint="Name a ppo run that succeeded.",
            )
        for name in self.teachers:
            check_name(name, field="config.teachers")
        if self.dataset:
            check_name(self.dataset, field="config.dataset")
        check_name(self.model_name, field="config.model_name")
        if self.config.get("policy", "language") != "language":
            raise InvalidInput(
                "The student follows words: `policy` must be language; got another.",
                field="config.config.policy",
                hint="Leave it out.",
            )
        fit.check_steps(self.config)

    @property
    def schedule(self) -> Schedule:
        """How much of each teacher is recorded."""
        return Schedule(self.rollouts, self.num_envs, self.is_stochastic, self.seed, self.keep)


def resolve(values: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the whole configuration."""
    config = parse(DistillConfig, values)
    return {**asdict(config), "teachers": list(config.teachers), "config": {**config.config, "policy": "language"}}


def steps(config: Mapping[str, Any]) -> int:
    """Returns the number of rollouts and of the fit's updates."""
    return len(config["teachers"]) * int(config["rollouts"]) + fit.steps(config)


def check(work: Work, earlier: Collection[str]) -> None:
    """Refuses teachers that are not there, or that cannot have one student."""
    config = parse(DistillConfig, work.config)
    if there := [_load(work, name) for name in config.teachers if name not in earlier]:
        _check_teachers(config, there)


def run(work: Work) -> bool:
    """Records the rollouts, then fits; killed at any moment, it goes on to the same dataset and the same model.

    Raises:
        InvalidInput: A teacher is missing, or they cannot have one student.
        ServiceError: A service refuses.
    """
    config = parse(DistillConfig, work.config)
    name = config.dataset or work.key
    torch.set_num_threads(_TORCH_THREADS)
    if not (work.artifacts / CARD).is_file():
        if dataset_path(work.data_dir, name).exists():
            raise _taken()
        taught.pin(work, config.teachers)
        policies = [_load(work, teacher) for teacher in config.teachers]
        _check_teachers(config, policies)
        patience = Patience(np.random.default_rng(), stop=work.stop, say=work.say)
        try:
            lessons.record(work, policies, config.schedule, patience)
        except Stopped:
            return False
        _note(work, name, policies)
    _publish(work, name)
    return fit.run(_fit(work, config, name))


KIND = Kind(resolve, steps, run, check)


def _load(work: Work, name: str) -> Policy:
    return policy_artifact.load(taught.policy_folder(work, name, field="config.teachers"), device=work.device)


def _check_teachers(config: DistillConfig, policies: Sequence[Policy]) -> None:
    check_alike([Bearing.of(policy) for policy in policies], student_camera=config.config.get("camera", ""))
    judged = [policy.card.get("reward") for policy in policies]
    if config.keep == "rewarded" and set(judged) != {"learned"}:
        raise InvalidInput(
            "Rollouts are kept by the reward that their teacher learned from, which must be a learned one for each; "
            f"got {', '.join(str(each) for each in judged)}.",
            field="config.keep",
            hint="Keep all.",
        )


def _note(work: Work, name: str, policies: Sequence[Policy]) -> None:
    """Notes, durably, that the dataset is whole; only then is it moved to its place."""
    dataset = Dataset(work.folder / lessons.ROLLOUTS)
    told = [{name: policy.card.get(name) for name in _TOLD} for policy in policies]
    save_teachers(work.folder / lessons.ROLLOUTS, told)
    card = {
        "dataset": name,
        "trajectories": len(dataset),
        "timesteps": int(dataset.lengths.sum()),
        "fingerprint": dataset.fingerprint,
        "teachers": told,
    }
    write_atomic(work.artifacts / CARD, json.dumps(card, indent=2).encode() + b"\n")


def _publish(work: Work, name: str) -> None:
    rollouts, place = work.folder / lessons.ROLLOUTS, dataset_path(work.data_dir, name)
    if not rollouts.is_dir():  # it is there already
        return
    place.parent.mkdir(parents=True, exist_ok=True)
    try:
        rollouts.rename(place)
    except OSError as error:
        if error.errno in (errno.EEXIST, errno.ENOTEMPTY):
            raise _taken() from None
        raise
    fsync_folder(place.parent)


def _fit(work: Work, config: DistillConfig, dataset: str) -> Work:
    asked = {
        "service": "imitation",
        "dataset": dataset,
        "model_name": config.model_name,
        "config": dict(config.config),
    }
    return work.part("fit", fit.resolve(asked), first_step=len(config.teachers) * config.rollouts)


def _taken() -> AlreadyExists:
    return AlreadyExists(
        "The rollouts need a dataset of their own; there is one of this name.",
        field="config.dataset",
        hint="Choose another name, or leave it out.",
    )
