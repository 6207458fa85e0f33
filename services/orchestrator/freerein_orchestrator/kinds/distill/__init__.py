"""Kind `distill`: clones single-task policies into one policy that follows sentences.

The teachers' rollouts become a dataset with goal texts; the imitation service fits a language policy on it. In further
iterations that student's own rollouts are added, with what the teachers would have done in them, and a student is
fitted again.

    <folder>/rollouts/                the dataset while it is recorded; then it moves to `<data>/datasets/<name>`
             rollouts/eye/            the first teacher's object encoder, where the student is to see by it
             artifacts/dataset.json   its name, size and fingerprint, once it is complete
             parts/fit/               the last fit, as kind `fit`
             parts/fit-<i>/           those before; `<name>.<i>` are their datasets and models
"""

import errno
import json
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import torch

from freerein.atomic_files import fsync_folder, write_atomic
from freerein.config import bounded, parse
from freerein.data import Dataset, dataset_path, save_teachers
from freerein.data.folder_locks import temporary_folder
from freerein.errors import AlreadyExists, InvalidInput
from freerein.learning import model_files
from freerein.learning.actor_critic import shared_object_encoder
from freerein.learning.actor_critic.object_encoder import OBJECT_ENCODER
from freerein.learning.actor_critic.policy_files import StoredPolicy
from freerein.types.common import ModelRef, check_name
from freerein_orchestrator.envs.policy_interface import PolicyInterface, check_teachers
from freerein_orchestrator.kinds import fit
from freerein_orchestrator.kinds.collect import CARD
from freerein_orchestrator.kinds.context import RunContext
from freerein_orchestrator.kinds.distill.rollouts import ROLLOUTS, Keep, RolloutPlan, record_rollouts
from freerein_orchestrator.kinds.fit import FitRunConfig
from freerein_orchestrator.kinds.kind import Kind
from freerein_orchestrator.kinds.metrics_logger import last_step
from freerein_orchestrator.kinds.policy_store import PolicyStore, is_step

_TORCH_THREADS = 1
_FIELD = "config.teachers"
_MODEL = "model.json"
_TEACHER_CARD = ("task", "goal_text", "reward", "supervision", "privileged", "sha256")


@dataclass(frozen=True)
class DistillConfig:
    """Configuration of a run of kind `distill`.

    Attributes:
        teachers: The policies: ids of ppo runs, names of earlier steps of the same pipeline, or of policies among the
            models of the orchestrator. Each card holds the policy's goal text and task.
        rollouts: Episodes per teacher and iteration; the dissertation has 50 (4.3).
        dagger_iterations: Iterations in which a student acts and the teachers say what they would have done; the
            dissertation has none.
        num_envs: Number of parallel environments.
        stochastic: Whether teachers' actions are sampled; else the most likely one is taken.
        keep: `all` rollouts, as in the dissertation, or those of teachers whose last frame the reward model rewards.
        seed: Seed of every episode.
        dataset: Name for the dataset of rollouts; empty for the run's id.
        model_name: Name for the student.
        config: Configuration of the fit of a language policy in the imitation service.

    Raises:
        InvalidInput: There is no teacher, a name is invalid, or the fit is not of a language policy.
    """

    teachers: tuple[str, ...]
    rollouts: int = bounded(50, least=1, most=100_000)
    dagger_iterations: int = bounded(0, least=0, most=100)
    num_envs: int = bounded(10, least=1, most=64)
    stochastic: bool = False
    keep: Keep = "all"
    seed: int = bounded(0, least=0, most=2**31 - 1)
    dataset: str = ""
    model_name: str = "language"
    config: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.teachers:
            raise InvalidInput(
                "`teachers` must name a policy; got none.", field=_FIELD, hint="Name a ppo run that succeeded."
            )
        for name in self.teachers:
            check_name(name, field=_FIELD)
        for iteration in range(self.dagger_iterations + 1):
            if self.dataset:
                check_name(self.name_of(self.dataset, iteration), field="config.dataset")
            check_name(self.name_of(self.model_name, iteration), field="config.model_name")
        if self.config.get("method", "language") != "language":
            raise InvalidInput(
                "The student follows sentences: `method` must be language; got another.",
                field="config.config.method",
                hint="Leave it out.",
            )
        fit.check_steps(self.config)

    @property
    def needs_object_encoder(self) -> bool:
        """Whether the student sees by its first teacher's object encoder."""
        return bool(self.config.get("encoder") == OBJECT_ENCODER)

    def fit(self, iteration: int) -> FitRunConfig:
        """Returns the fit of the student of an iteration."""
        dataset, model = (self.name_of(each, iteration) for each in (self.dataset or "unnamed", self.model_name))
        return FitRunConfig("imitation", dataset, model, {**self.config, "method": "language"})

    def name_of(self, name: str, iteration: int) -> str:
        """Returns the name of a dataset or a model as it is after an iteration; the last one's has no addition."""
        return name if iteration == self.dagger_iterations else f"{name}.{iteration}"


def steps(config: DistillConfig) -> int:
    """Returns the number of rollouts and of the fits' updates."""
    return (config.dagger_iterations + 1) * (_rollouts(config) + _updates(config))


def check(config: DistillConfig, store: PolicyStore, earlier: Mapping[str, str]) -> None:
    """Checks that the teachers exist, or will, and can have one student."""
    made = [name for name in config.teachers if not is_step(name, earlier, field=_FIELD)]
    if found := [store.load(name, field=_FIELD) for name in made]:
        _check_teachers(config, found)


def truth(config: Mapping[str, Any], store: PolicyStore) -> str:
    """Returns the supervision of the teachers that are privileged; empty without any."""
    return "; ".join(filter(None, dict.fromkeys(map(store.privileged_supervision, config["teachers"]))))


def run(context: RunContext, config: DistillConfig) -> None:
    """Records the rollouts, then fits; killed at any moment, it resumes to the same dataset and the same model.

    Raises:
        Stopped: The run is to stop.
        InvalidInput: A teacher is missing, or they cannot have one student.
        ServiceError: A service refuses.
    """
    config = replace(config, dataset=config.dataset or context.key)
    torch.set_num_threads(_TORCH_THREADS)
    if not (context.artifacts / CARD).is_file():
        _check_names(context, config)
        context.policies.pin(config.teachers)
        policies = [context.policies.load(name, field=_FIELD, device=context.device) for name in config.teachers]
        _check_teachers(config, policies)
        phrases = _located_phrases(context, policies[0]) if config.needs_object_encoder else ()
        plan = RolloutPlan(config.rollouts, config.num_envs, config.stochastic, config.seed, config.keep)
        students = list(_fitted(context, config))
        for iteration in range(len(students), config.dagger_iterations + 1):
            recording = replace(context, first_step=context.first_step + _updates_before(context, config, iteration))
            record_rollouts(recording, policies, plan, students=students)
            cards = [{name: policy.card.get(name) for name in _TEACHER_CARD} for policy in policies]
            save_teachers(context.folder / ROLLOUTS, cards)
            if config.needs_object_encoder:
                folder = context.folder / ROLLOUTS / shared_object_encoder.FOLDER
                shared_object_encoder.save_object_encoder(policies[0], phrases=phrases, folder=folder)
            if iteration < config.dagger_iterations:
                _publish_copy(context, config.fit(iteration).dataset)
                students.append(_fit(context, config, iteration))
        _write_card(context, config, cards)
    _publish(context, config.dataset)
    _fit(context, config, config.dagger_iterations)


def _rollouts(config: DistillConfig) -> int:
    return len(config.teachers) * config.rollouts


def _updates(config: DistillConfig) -> int:
    return fit.KIND.steps(config.fit(0))


def _updates_before(context: RunContext, config: DistillConfig, iteration: int) -> int:
    """Returns the updates of the fits before an iteration: the service may choose their number."""
    if not iteration:
        return 0
    last = last_step(context.run_folder, prefix=f"{context.prefix}fit-{iteration - 1}/")
    return max(0, last - context.first_step - iteration * _rollouts(config))


def _fit(context: RunContext, config: DistillConfig, iteration: int) -> ModelRef:
    """Fits the student of an iteration, or finds it, and returns it."""
    name = "fit" if iteration == config.dagger_iterations else f"fit-{iteration}"
    first_step = (iteration + 1) * _rollouts(config) + _updates_before(context, config, iteration)
    child = context.child(name, first_step=first_step)
    fit.run(child, config.fit(iteration))
    return ModelRef(**json.loads((child.folder / _MODEL).read_bytes()))


def _fitted(context: RunContext, config: DistillConfig) -> Iterator[ModelRef]:
    """Yields the students of the iterations that are over, the last one's excepted."""
    for iteration in range(config.dagger_iterations):
        path = context.folder / "parts" / f"fit-{iteration}" / _MODEL
        if not path.is_file():
            return
        yield ModelRef(**json.loads(path.read_bytes()))


KIND = Kind(
    {"": DistillConfig},
    partial(parse, DistillConfig),
    steps,
    run,
    check,
    truth=truth,
    meaning="Clones policies for one task each into one policy that follows sentences.",
)


def _check_teachers(config: DistillConfig, policies: Sequence[StoredPolicy]) -> None:
    check_teachers(
        [PolicyInterface.of_stored(policy) for policy in policies], student_cameras=config.config.get("cameras", [])
    )
    if config.needs_object_encoder and policies[0].network.eye is None:
        raise shared_object_encoder.no_object_encoder()
    rewards = [policy.card.get("reward") for policy in policies]
    if config.keep == "rewarded" and set(rewards) != {"learned"}:
        raise InvalidInput(
            "To keep rewarded rollouts, every teacher must have been trained on a learned reward; "
            f"got {', '.join(map(str, rewards))}.",
            field="config.keep",
            hint="Keep all.",
        )


def _located_phrases(context: RunContext, teacher: StoredPolicy) -> tuple[str, ...]:
    """Returns the phrases that the reward model of a teacher's object encoder knows."""
    card = model_files.read_card(context.reward_models.folder(ModelRef(**teacher.card["eye"])))
    return tuple(map(str, card["spec"]["phrases"]))


def _check_names(context: RunContext, config: DistillConfig) -> None:
    """Raises AlreadyExists where a dataset has a name that this run needs and has not taken yet."""
    is_begun = (context.folder / ROLLOUTS).is_dir()
    iterations = range(config.dagger_iterations if is_begun else 0, config.dagger_iterations + 1)
    names = [config.name_of(config.dataset, iteration) for iteration in iterations]
    if any(dataset_path(context.data_dir, name).exists() for name in names):
        raise _name_taken()


def _write_card(context: RunContext, config: DistillConfig, teachers: Sequence[Mapping[str, Any]]) -> None:
    """Records, durably, that the dataset is complete; only then is it published."""
    dataset = Dataset(context.folder / ROLLOUTS)
    card = {
        "dataset": config.dataset,
        "trajectories": len(dataset),
        "timesteps": int(dataset.lengths.sum()),
        "fingerprint": dataset.fingerprint,
        "dagger_iterations": config.dagger_iterations,
        "teachers": teachers,
    }
    write_atomic(context.artifacts / CARD, json.dumps(card, indent=2).encode() + b"\n")


def _publish_copy(context: RunContext, name: str) -> None:
    """Publishes the dataset as it is now, unless that is done; files are shared, for they are never changed.

    Raises:
        AlreadyExists: There is another dataset of that name.
    """
    rollouts, target = context.folder / ROLLOUTS, dataset_path(context.data_dir, name)
    if target.exists():
        if Dataset(target).fingerprint != Dataset(rollouts).fingerprint:
            raise _name_taken()
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    with temporary_folder(target.parent, prefix=".copy-") as staging:
        copy = shutil.copytree(rollouts, staging / name, copy_function=os.link, ignore=shutil.ignore_patterns("*.lock"))
        copy.rename(target)
    fsync_folder(target.parent)


def _publish(context: RunContext, name: str) -> None:
    rollouts, target = context.folder / ROLLOUTS, dataset_path(context.data_dir, name)
    if not rollouts.is_dir():  # published already
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        rollouts.rename(target)
    except OSError as error:
        if error.errno in (errno.EEXIST, errno.ENOTEMPTY):
            raise _name_taken() from None
        raise
    fsync_folder(target.parent)


def _name_taken() -> AlreadyExists:
    return AlreadyExists(
        "The rollouts need a new dataset; there is one of this name.",
        field="config.dataset",
        hint="Choose another name, leave it out, or delete that dataset: `freerein dataset rm NAME`.",
    )
