"""Policies of the world `blocks`: what they learn from, how they are fitted, and what they achieve, as pipelines.

A learner sees images, executed actions, tags and goal texts; true states are read by evaluations alone.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from experiments.robustness import confidence
from experiments.robustness.services import Step, Trials
from experiments.robustness.worlds import CURRICULUM, DEMONSTRATED
from experiments.workbench.arms import Arm
from experiments.workbench.results import Outcome, Sample

FLAG_AUROC, FLAG_ECE, FLAG_RECALL = "flag.auroc", "flag.ece", "flag.recall"
LANDMARKS_FREE, LANDMARKS_BLOCK = "landmarks.free", "landmarks.block"
RECIPE_SKILLS, RECIPE_WHOLE = "recipe.skills", "recipe.whole"
RETURN_ALL, RETURN_WRONG_ORDER = "return.all", "return.wrong-order"

GOAL_CONDITIONED, INVERSE_MODEL = "goal_conditioned", "inverse_model"
SKILLS, EXPERT = "skills", "expert"
PPO = "ppo_training"

SIDES = ("blocks.yellow-left-of-green", "blocks.yellow-right-of-green")
STACK = "blocks.yellow-on-top-of-green"
PPO_SEEDS = 5

_HELD_OUT_SEED = 1_000_003
_LANDMARK_EPISODES, _RECIPES, _RETURN_EPISODES = 128, 100, 100
_NUM_ENVS = 64
_IN_ORDER = "start/in-order"
_PRECISION = 0.9


@dataclass(frozen=True)
class PolicyArm:
    """How arms of a method are made.

    Attributes:
        steps: Returns the pipeline of an arm.
        samples: Returns its figures from the trials of the pipeline's evaluations.
    """

    steps: Callable[[Arm], Sequence[Step]]
    samples: Callable[[Trials], Mapping[str, Sample]]

    def outcome(self, trials: Trials) -> Outcome:
        """Returns what the arm measured."""
        return Outcome({}, self.samples(trials))


def _follow(arm: Arm) -> list[Step]:
    return [
        _step(
            "exploration",
            "collect",
            dataset="exploration",
            task=arm.world,
            behaviour="random",
            count=400,
            seed=arm.seed,
        ),
        _fit("fit", "imitation", "exploration", method=arm.method, seed=arm.seed),
        _evaluate("landmarks", task=arm.world, policy={"model": "default"}, episodes=_LANDMARK_EPISODES),
    ]


def _execute_recipes(arm: Arm) -> list[Step]:
    return [
        _step(
            "demonstrations",
            "collect",
            dataset="demonstrations",
            task=arm.world,
            behaviour="expert",
            count=400,
            min_skills=2,
            max_skills=3,
            seed=arm.seed,
        ),
        _fit("fit-labels", "segmentation", "demonstrations", stride=3, seed=arm.seed),
        _step("labels", "label", dataset="demonstrations", smoothing=1),
        _fit("fit", "imitation", "demonstrations", method=arm.method, seed=arm.seed),
        _evaluate("recipes", task=arm.world, policy={"model": "default"}, episodes=_RECIPES),
    ]


def _expert_recipes(arm: Arm) -> list[Step]:
    return [_evaluate("recipes", task=arm.world, policy="expert", episodes=_RECIPES)]


def _reinforce(arm: Arm) -> list[Step]:
    return [
        _step("ppo", "ppo", task=arm.world, conditions=[CURRICULUM], seed=arm.seed),
        _evaluate("returns", task=arm.world, policy={"run": "ppo"}, baseline="random", episodes=_RETURN_EPISODES),
    ]


def _landmark_samples(trials: Trials) -> Iterator[tuple[str, Sample]]:
    measured = [trial for trial in trials["landmarks"] if trial]
    lengths = [len(trial["confidence"]) for trial in measured]
    trial = np.repeat(np.arange(len(measured)), lengths)
    score = np.concatenate([np.array(each["confidence"]) for each in measured])
    at_landmark = np.concatenate([np.array(each["at_landmark"], np.bool_) for each in measured])
    yield FLAG_AUROC, confidence.auroc(score, at_landmark, trial)
    yield FLAG_ECE, confidence.calibration_error(score, at_landmark, trial)
    yield FLAG_RECALL, _recall(score, at_landmark, trial)
    for name, counted in ((LANDMARKS_FREE, False), (LANDMARKS_BLOCK, True)):
        kept = [np.array(each["moves"], np.bool_) == counted for each in measured]
        recognized = [np.array(each["recognized"], np.bool_) for each in measured]
        yield name, _share([flags[keep] for flags, keep in zip(recognized, kept, strict=True)])


def _recall(score: npt.NDArray[np.float64], right: npt.NDArray[np.bool_], trial: npt.NDArray[np.int64]) -> Sample:
    """Returns the recall at the lowest threshold whose precision is high enough; the interval holds it fixed."""
    order = np.argsort(-score, kind="stable")
    last = np.append(np.diff(score[order]) < 0, True)  # equal scores are above a threshold together
    precision = np.cumsum(right[order]) / np.arange(1, len(order) + 1)
    enough = np.flatnonzero((precision >= _PRECISION) & last)
    threshold = score[order][enough[-1]] if len(enough) else np.inf
    return confidence.by_trial((score >= threshold) & right, right, trial)


def _recipe_samples(trials: Trials) -> Iterator[tuple[str, Sample]]:
    completed = [np.array(each["completed"], np.bool_) for each in trials["recipes"]]
    yield RECIPE_SKILLS, _share(completed)
    yield RECIPE_WHOLE, _share([np.array([each.all()]) for each in completed])


def _return_samples(trials: Trials) -> Iterator[tuple[str, Sample]]:
    """Yields returns as a share of the expert's in the same episodes."""
    episodes = trials["returns"]
    in_wrong_order = [each for each in episodes if not each["starts"].get(_IN_ORDER, True)]
    for name, part in ((RETURN_ALL, episodes), (RETURN_WRONG_ORDER, in_wrong_order)):
        if part:
            yield name, Sample([each["episode_return"] for each in part], [each["expert_return"] for each in part])


def _share(flags: Sequence[npt.NDArray[np.bool_]]) -> Sample:
    """Returns the share of flags that are true, over trials that have some."""
    present = [each for each in flags if len(each)]
    return Sample([int(each.sum()) for each in present], [len(each) for each in present])


def _step(name: str, kind: str, **config: Any) -> Step:
    return {"name": name, "kind": kind, "config": config}


def _fit(name: str, service: str, dataset: str, **config: Any) -> Step:
    return _step(name, "fit", service=service, dataset=dataset, config=config)


def _evaluate(form: str, **config: Any) -> Step:
    return _step(form, "evaluate", form=form, num_envs=_NUM_ENVS, seed=_HELD_OUT_SEED, **config)


def _samples(found: Callable[[Trials], Iterator[tuple[str, Sample]]]) -> Callable[[Trials], Mapping[str, Sample]]:
    return lambda trials: dict(found(trials))


_FOLLOWER = PolicyArm(_follow, _samples(_landmark_samples))

METHODS: Mapping[str, PolicyArm] = MappingProxyType(
    {
        GOAL_CONDITIONED: _FOLLOWER,
        INVERSE_MODEL: _FOLLOWER,
        SKILLS: PolicyArm(_execute_recipes, _samples(_recipe_samples)),
        EXPERT: PolicyArm(_expert_recipes, _samples(_recipe_samples)),
        PPO: PolicyArm(_reinforce, _samples(_return_samples)),
    }
)
"""How arms are made, by method."""


def arms(seeds: int) -> tuple[Arm, ...]:
    """Returns the arms, each with so many seeds; those of PPO with more, and the expert with one."""
    fitted = (GOAL_CONDITIONED, INVERSE_MODEL, SKILLS)
    return (
        Arm(DEMONSTRATED, EXPERT),
        *(Arm(DEMONSTRATED, method, seed=seed) for seed in range(seeds) for method in fitted),
        *(Arm(task, PPO, seed=seed) for seed in range(PPO_SEEDS) for task in (*SIDES, STACK)),
    )
