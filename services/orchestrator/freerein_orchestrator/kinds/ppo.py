"""Runs of the kind `ppo`: a policy for one task, taught by rewards for what is seen, over the network.

<run>/checkpoints/   freerein_orchestrator.ppo_course
      artifacts/     the policy, freerein_orchestrator.policy_artifact
"""

from collections.abc import Collection, Mapping
from dataclasses import asdict
from typing import Any, cast

import numpy as np

from freerein.learning.checkpoints import JSON
from freerein.learning.config import parse
from freerein_orchestrator import policy_artifact
from freerein_orchestrator.kinds.kind import Kind
from freerein_orchestrator.patience import Patience, Stopped
from freerein_orchestrator.ppo_config import PPORunConfig, RewardForm
from freerein_orchestrator.ppo_course import Course
from freerein_orchestrator.ppo_training import PPOTraining
from freerein_orchestrator.served_task import ServedTask
from freerein_orchestrator.taught import policy_folder
from freerein_orchestrator.work import Work

_SUPERVISION: Mapping[RewardForm, str] = {
    "learned": "goal text; the reward model saw images, noun phrases and captions told from pixels",
    "base": "goal text; the grounding model saw captions of single objects",
    "oracle": "the task's true reward, which is privileged: to compare with",
}


def resolve(config: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the whole configuration for a partial one.

    Raises:
        InvalidInput: It cannot be.
    """
    return asdict(parse(PPORunConfig, config))


def run(work: Work) -> bool:
    """Trains the policy, or goes on training it; returns True when it is done and False when it was stopped.

    Raises:
        InvalidInput: The configuration does not fit the task.
        NotFound: There is no such task or model.
        FailedPrecondition: Three iterations in a row were worthless, or the disk is full, or the run was begun with
            something else.
    """
    config = parse(PPORunConfig, work.config)
    patience = Patience(np.random.default_rng(), stop=work.stop, say=work.say)
    task = ServedTask(work, config, patience)
    course = Course(
        work.folder,
        begin=task.begin,
        resume=task.resume,
        rollouts=task.rollouts,
        curve=lambda last_step: work.curve(last_step=last_step),
        interrupt=patience.interrupt,
        say=work.say,
    )
    try:
        training = course.finish()
    except Stopped:
        return False
    policy_artifact.save(training.network, work.artifacts, card=_card(config, training))
    return True


def check(work: Work, earlier: Collection[str]) -> None:
    """Checks that the policy to start from is there, or will be.

    Raises:
        InvalidInput: It is not.
    """
    name = parse(PPORunConfig, work.config).start_from
    if name and name not in earlier:
        policy_artifact.load(policy_folder(work, name, field="config.start_from"), device="cpu")


KIND = Kind(resolve=resolve, steps=lambda config: int(config["iterations"]), run=run, check=check)


def _card(config: PPORunConfig, training: PPOTraining) -> dict[str, JSON]:
    start = cast(Mapping[str, JSON], training.terms.get("start"))
    before = f"; it began as a policy with this supervision: {start['supervision']}" if start else ""
    return {
        "task": config.task,
        **training.terms,
        "reward": config.reward,
        "supervision": _SUPERVISION[config.reward] + before,
        "config": asdict(config),
        "figures": {
            "iterations": training.iteration,
            "timesteps": training.iteration * config.num_envs * config.steps,
            **training.metrics,
        },
    }
