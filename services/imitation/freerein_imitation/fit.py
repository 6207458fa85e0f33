"""A fit as a process of its own: `python -m freerein_imitation.fit FOLDER DATA_DIR DEVICE`.

FOLDER holds `config.json`; metrics and checkpoints are written there, and in the end `model/`. The exit codes are those
of `freerein.serving.fit_child.run`. The configuration's `policy` says which kind of policy is fitted.
"""

import sys
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from freerein.data import Dataset, dataset_path, labels
from freerein.errors import InvalidInput
from freerein.learning.exports import choose_device, export
from freerein.learning.fit import Fitted, fit, stop_on_sigterm
from freerein.serving import fit_child
from freerein_imitation.model import (
    GoalConditionedNetwork,
    GoalConditionedPolicy,
    Handshake,
    SkillsNetwork,
    SkillsPolicy,
)
from freerein_imitation.training import goal_conditioned, skills
from freerein_imitation.training.exploration import Exploration, hold_out
from freerein_imitation.training.goal_conditioned import GoalConditionedConfig, GoalConditionedProblem
from freerein_imitation.training.skills import SkillsConfig, SkillsProblem


@dataclass(frozen=True)
class _Kind:
    """A kind of policy, as a fit knows it.

    Attributes:
        resolve: Returns the whole configuration of a fit on a dataset.
        train: Writes the model into the fit's folder and returns True, or returns False when stopped before.
    """

    resolve: Callable[["_Source", Mapping[str, Any]], dict[str, Any]]
    train: Callable[[Path, "_Source", Mapping[str, Any], str], bool]


@dataclass(frozen=True, eq=False)
class _Source:
    """What is learned from.

    Attributes:
        root: The dataset's folder.
        dataset: It, opened.
    """

    root: Path
    dataset: Dataset


def _open(data_dir: Path, name: str) -> _Source:
    return _Source(dataset_path(data_dir, name), fit_child.open_dataset(data_dir, name))


def resolve(data_dir: Path, dataset: str, values: Mapping[str, Any], *, threads: int) -> dict[str, Any]:
    """Returns the whole configuration of a fit.

    Args:
        data_dir: The data directory.
        dataset: A dataset's name.
        values: What was asked for.
        threads: Of torch, where not asked for.

    Raises:
        NotFound: There is no such dataset.
        InvalidInput: The configuration is wrong, or the dataset cannot be learned from.
        FailedPrecondition: Skills are to be learned, and the dataset is not labelled.
    """
    kind = _kind(values)
    return kind.resolve(_open(data_dir, dataset), {"threads": threads, **values})


def main(folder: Path, data_dir: Path, device: str) -> int:
    """Fits a model, or goes on fitting it; returns the process's exit code."""

    def train(dataset: str, values: Mapping[str, Any]) -> bool:
        return _kind(values).train(folder, _open(data_dir, dataset), values, device)

    return fit_child.run(folder, train)


def _kind(values: Mapping[str, Any]) -> _Kind:
    asked = values.get("policy", GoalConditionedPolicy.kind)
    kinds = {
        GoalConditionedPolicy.kind: _Kind(_resolve_goal_conditioned, _train_goal_conditioned),
        SkillsPolicy.kind: _Kind(_resolve_skills, _train_skills),
    }
    if not isinstance(asked, str) or asked not in kinds:
        raise InvalidInput(
            f"`policy` must be {' or '.join(kinds)}; got something else.",
            field="config.policy",
            hint="Leave it out for goal images.",
        )
    return kinds[asked]


def _resolve_goal_conditioned(source: _Source, values: Mapping[str, Any]) -> dict[str, Any]:
    config = GoalConditionedConfig.from_mapping(values)
    config = replace(config, camera=fit_child.choose_camera(source.dataset, config.camera))
    timestep = _timestep(source.dataset, config.camera)
    goal_conditioned.design(config, timestep, action_choices=source.dataset.spec.action.choices)
    return asdict(config)


def _timestep(dataset: Dataset, camera: str) -> Exploration:
    """Returns one timestep of the sizes of a dataset's: enough for a design to refuse what there is no network for."""
    spec = dataset.spec
    frame, action = np.zeros((1, *spec.cameras[camera]), np.uint8), np.zeros((1, spec.action.size), np.float32)
    return Exploration([frame], [action])


def _train_goal_conditioned(folder: Path, source: _Source, values: Mapping[str, Any], device: str) -> bool:
    problem = _goal_conditioned_problem(source.dataset, GoalConditionedConfig.from_mapping(values), device)
    with stop_on_sigterm() as stop:
        fitted = fit(problem, problem.config.plan, folder, stop=stop)
    if fitted is None:
        return False
    export(fitted.network, folder / "model", card=_goal_conditioned_card(source.dataset, problem, fitted))
    return True


def _goal_conditioned_problem(dataset: Dataset, config: GoalConditionedConfig, device: str) -> GoalConditionedProblem:
    exploration = Exploration(dataset.cached_frames(config.camera), dataset.cached_actions())
    training, validation = hold_out(
        exploration, share=config.validation_share, seed=config.seed, shortest=config.shortest_slice + 1
    )
    spec = goal_conditioned.design(config, training, action_choices=dataset.spec.action.choices)
    return GoalConditionedProblem(config, spec, training, validation, dataset.fingerprint, choose_device(device))


def _goal_conditioned_card(
    dataset: Dataset, problem: GoalConditionedProblem, fitted: Fitted[GoalConditionedNetwork]
) -> dict[str, Any]:
    held_out = goal_conditioned.evaluate(fitted.network, problem.validation, config=problem.config)
    handshake = Handshake(
        action=dataset.spec.action,
        control_dt_s=1 / dataset.spec.fps,
        reached_threshold=goal_conditioned.reached_threshold(fitted.network, problem.validation),
        max_steps_per_goal=2 * problem.config.longest_slice,
    )
    return {
        "kind": GoalConditionedPolicy.kind,
        **handshake.to_card(),
        "command": "freerein fit imitation DATASET",
        "task": dataset.spec.task,
        "data": {"trajectories": len(dataset), "fingerprint": dataset.fingerprint},
        "config": asdict(problem.config),
        "figures": {
            "validation_loss": fitted.validation_loss,
            "best_step": fitted.best_step,
            "action_loss": held_out.action.item(),
            "goal_loss": held_out.recognition.item(),
        },
        "supervision": "images and executed actions of exploration",
    }


def _resolve_skills(source: _Source, values: Mapping[str, Any]) -> dict[str, Any]:
    config = SkillsConfig.from_mapping(values)
    config = replace(config, camera=fit_child.choose_camera(source.dataset, config.camera))
    vocabulary, choices = labels.info(source.root).skills, source.dataset.spec.action.choices
    skills.design(config, _timestep(source.dataset, config.camera), skills=vocabulary, action_choices=choices)
    return asdict(config)


def _train_skills(folder: Path, source: _Source, values: Mapping[str, Any], device: str) -> bool:
    problem = _skills_problem(source, SkillsConfig.from_mapping(values), device)
    with stop_on_sigterm() as stop:
        fitted = fit(problem, problem.config.plan, folder, stop=stop)
    if fitted is None:
        return False
    export(fitted.network, folder / "model", card=_skills_card(source, problem, fitted))
    return True


def _skills_problem(source: _Source, config: SkillsConfig, device: str) -> SkillsProblem:
    dataset = source.dataset
    labelled = labels.all_labels(source.root, dataset.lengths)
    torch.set_num_threads(config.threads)
    return skills.prepare(
        config,
        Exploration(dataset.cached_frames(config.camera), dataset.cached_actions()),
        labelled,
        skills=labels.info(source.root).skills,
        action_choices=dataset.spec.action.choices,
        fingerprint=f"{dataset.fingerprint} {labels.fingerprint(labelled)}",
        device=choose_device(device),
    )


def _skills_card(source: _Source, problem: SkillsProblem, fitted: Fitted[SkillsNetwork]) -> dict[str, Any]:
    held_out = skills.evaluate(fitted.network, problem.validation, config=problem.config)
    handshake = Handshake(
        action=source.dataset.spec.action,
        control_dt_s=1 / source.dataset.spec.fps,
        reached_threshold=skills.END_THRESHOLD,
        max_steps_per_goal=problem.max_steps_per_skill,
    )
    return {
        "kind": SkillsPolicy.kind,
        **handshake.to_card(),
        "command": "freerein fit imitation DATASET --set policy=skills",
        "task": source.dataset.spec.task,
        "data": {"trajectories": len(source.dataset), "fingerprint": problem.fingerprint},
        "labels": asdict(labels.info(source.root)),
        "config": asdict(problem.config),
        "figures": {
            "validation_loss": fitted.validation_loss,
            "best_step": fitted.best_step,
            "action_loss": held_out.action.item(),
            "end_loss": held_out.end.item(),
            "segments": len(problem.training) + len(problem.validation),
        },
        "supervision": "images and executed actions of demonstrations, and skills predicted from tags",
    }


if __name__ == "__main__":
    raise SystemExit(main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]))
