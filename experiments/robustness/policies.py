"""Policies of the world `blocks`: what they learn from, how they are fitted, and what they achieve, as pipelines.

A learner sees images, executed actions, tags and goal texts; true states are read by evaluations alone.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np

from experiments.robustness import language
from experiments.robustness.evaluated import evaluate, flagged
from experiments.robustness.language import SIDES
from experiments.robustness.worlds import CURRICULUM, DEMONSTRATED, NEAR, NOMINAL
from experiments.workbench.arms import Arm
from experiments.workbench.pipelines import Step, Trials, fit_step, step
from experiments.workbench.results import Outcome, Sample

LANDMARKS_FREE, LANDMARKS_BLOCK = "landmarks.free", "landmarks.block"
RECIPE_SKILLS, RECIPE_WHOLE = "recipe.skills", "recipe.whole"
RECIPE_OF_NOMINAL = "recipe.of-nominal"
"""Skills that are completed under a condition, as a share of those that are completed nominally."""
RETURN_ALL, RETURN_WRONG_ORDER = "return.all", "return.wrong-order"

GOAL_CLONING, GOAL_CLONING_AUGMENTED, GOAL_CONDITIONED = "goal_cloning", "goal_cloning_augmented", "goal_conditioned"
SKILLS, SKILLS_AUGMENTED, EXPERT = "skills", "skills_augmented", "expert"
PPO, PPO_NEAR, PPO_NEAR_CARRY = "ppo_training", "ppo_near", "ppo_near_carry"
PPO_OWN_STARTS, PPO_PRACTICE = "ppo_own_starts", "ppo_practice"
PPO_AUGMENTED = "ppo_augmented"
LANGUAGE, LANGUAGE_DONE, LANGUAGE_DONE_AT_ONCE = "language", "language_done", "language_done_at_once"
PPO_SPEED = "ppo_speed"

STACK = "blocks.yellow-on-top-of-green"
PPO_SEEDS, SPEED_RUNS = 5, 5
_ALL_SEEDS = (range(PPO_SEEDS),) * 3
_SEEDS_OF: Mapping[str, tuple[Sequence[int], ...]] = MappingProxyType(
    {PPO_NEAR: ((), (3,), (0,)), PPO_NEAR_CARRY: ((4,), (3,), (0,)), PPO_PRACTICE: (range(4), range(3), range(4))}
)
"""Seeds of PPO, to the left, to the right and stacking, where they are fewer: single ones repeat failures of others."""

_LABEL_STEPS = 4000
"""Twice the default: with tags of two or three skills, a fit may confuse two of four for 1 500 steps."""

_STARTS: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        PPO: {"conditions": [CURRICULUM], "augmentation": 0.0},
        PPO_AUGMENTED: {"conditions": [CURRICULUM]},
        PPO_NEAR: {"conditions": [NEAR], "augmentation": 0.0},
        PPO_NEAR_CARRY: {"conditions": [NEAR], "carry_weight": 1.0, "augmentation": 0.0},
        PPO_OWN_STARTS: {"conditions": [], "augmentation": 0.0},
        PPO_PRACTICE: {"conditions": [], "practice_share": 0.5, "augmentation": 0.0},
    }
)
"""Where episodes of a training by PPO begin, and whether its eye is fitted to augmented frames, by method."""

_UNAUGMENTED: Mapping[str, Any] = MappingProxyType({"augmentation": 0.0, "normalise_exposure": False})
"""Of fits that see frames as they were recorded."""

SHIFTED = ("light-0.8", "camera-5cm", "hue-plus-10", "hue-minus-10")
"""Conditions under which policies that were fitted with augmented frames act, too."""

SHIFTED_SCENES = ("light-0.8", "blocks-4", "camera-5cm")
"""Conditions under which policies act whose eye was fitted to augmented frames."""

CONDITIONS = tuple(dict.fromkeys((NOMINAL, *SHIFTED, *SHIFTED_SCENES)))
"""All conditions under which policies act."""

_LANDMARK_EPISODES, _RECIPES, _RETURN_EPISODES = 128, 100, 100
_IN_ORDER = "start/in-order"


@dataclass(frozen=True)
class PolicyArm:
    """The recipe of a method's arms.

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
    as_measured = {**_UNAUGMENTED, "features": 80} if arm.method == GOAL_CLONING else {}
    return [*_follower(arm, method=arm.method, **as_measured), _landmarks(NOMINAL)]


def _follow_shifted(arm: Arm) -> list[Step]:
    fitted = _follower(arm, method=GOAL_CLONING)
    return [*fitted, *(_landmarks(condition) for condition in (NOMINAL, *SHIFTED))]


def _follower(arm: Arm, **config: Any) -> list[Step]:
    """Returns the steps that explore, and fit a policy that follows goal images."""
    return [
        step(
            "exploration",
            "collect",
            dataset="exploration",
            task=arm.world,
            behaviour="random",
            count=600,
            seed=arm.seed,
        ),
        fit_step("fit", "imitation", "exploration", **config, seed=arm.seed),
    ]


def _execute_recipes(arm: Arm) -> list[Step]:
    return [*_skills(arm, **_UNAUGMENTED), _recipes(NOMINAL)]


def _execute_shifted_recipes(arm: Arm) -> list[Step]:
    return [*_skills(arm), *(_recipes(condition) for condition in (NOMINAL, *SHIFTED))]


def _skills(arm: Arm, **config: Any) -> list[Step]:
    """Returns the steps that demonstrate, label and fit skills."""
    return [
        step(
            "demonstrations",
            "collect",
            dataset="demonstrations",
            task=arm.world,
            behaviour="expert",
            count=2000,
            min_skills=2,
            max_skills=3,
            seed=arm.seed,
        ),
        fit_step(
            "fit-labels",
            "segmentation",
            "demonstrations",
            stride=3,
            steps=_LABEL_STEPS,
            augmentation=0.0,
            seed=arm.seed,
        ),
        step("labels", "label", dataset="demonstrations", smoothing=1),
        fit_step("fit", "imitation", "demonstrations", method=SKILLS, **config, seed=arm.seed),
    ]


def _recipes(condition: str) -> Step:
    """Returns the evaluation of the fitted skills under a condition."""
    return _evaluate_fit("recipes", condition, episodes=_RECIPES)


def _landmarks(condition: str) -> Step:
    """Returns the evaluation of the fitted follower of goal images under a condition."""
    return _evaluate_fit("landmarks", condition, episodes=_LANDMARK_EPISODES)


def _evaluate_fit(form: str, condition: str, *, episodes: int) -> Step:
    conditions = {} if condition == NOMINAL else {"conditions": [condition]}
    policy = {"model": "default"}
    return evaluate(
        form, _step_name(form, condition), task=DEMONSTRATED, policy=policy, episodes=episodes, **conditions
    )


def _step_name(form: str, condition: str) -> str:
    return form if condition == NOMINAL else f"{form}-{condition.replace('.', '')}"


def under(condition: str, figure: str) -> str:
    """Returns the name of a figure under a condition."""
    return figure if condition == NOMINAL else f"{condition}.{figure}"


def _expert_recipes(arm: Arm) -> list[Step]:
    return [evaluate("recipes", task=arm.world, policy="expert", episodes=_RECIPES)]


def _reinforce(arm: Arm) -> list[Step]:
    return [
        step("ppo", "ppo", task=arm.world, **_STARTS[arm.method], seed=arm.seed),
        _returns(arm, NOMINAL),
        *(_returns(arm, condition) for condition in (SHIFTED_SCENES if arm.method == PPO_AUGMENTED else ())),
    ]


def _returns(arm: Arm, condition: str) -> Step:
    """Returns the evaluation of the trained policy under a condition."""
    more = {} if condition == NOMINAL else {"conditions": [condition]}
    name, policy = _step_name("returns", condition), {"run": "ppo"}
    return evaluate(
        "returns", name, task=arm.world, policy=policy, baseline="random", episodes=_RETURN_EPISODES, **more
    )


def _landmark_samples(trials: Trials) -> Iterator[tuple[str, Sample]]:
    for condition, episodes in _by_condition("landmarks", trials):
        for figure, sample in _followed(episodes):
            yield under(condition, figure), sample


def _by_condition(form: str, trials: Trials) -> Iterator[tuple[str, Sequence[Mapping[str, Any]]]]:
    """Yields the conditions under which a form was evaluated, each with its trials."""
    for condition in CONDITIONS:
        if episodes := trials.get(_step_name(form, condition)):
            yield condition, episodes


def _followed(trials: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, Sample]]:
    measured = [trial for trial in trials if trial]
    yield from flagged(measured, "at_landmark")
    for name, counted in ((LANDMARKS_FREE, False), (LANDMARKS_BLOCK, True)):
        kept = [np.array(each["moves"], np.bool_) == counted for each in measured]
        recognized = [np.array(each["recognized"], np.bool_) for each in measured]
        yield name, Sample.of_flags([flags[keep] for flags, keep in zip(recognized, kept, strict=True)])


def _recipe_samples(trials: Trials) -> Iterator[tuple[str, Sample]]:
    nominal = [sum(each["completed"]) for each in trials["recipes"]]
    for condition, episodes in _by_condition("recipes", trials):
        completed = [np.array(each["completed"], np.bool_) for each in episodes]
        yield under(condition, RECIPE_SKILLS), Sample.of_flags(completed)
        yield under(condition, RECIPE_WHOLE), Sample.of_flags([np.array([each.all()]) for each in completed])
        if condition != NOMINAL:
            done = [int(each.sum()) for each in completed]
            yield under(condition, RECIPE_OF_NOMINAL), Sample(done, nominal)


def _return_samples(trials: Trials) -> Iterator[tuple[str, Sample]]:
    """Yields returns as a share of the expert's in the same episodes."""
    for condition, episodes in _by_condition("returns", trials):
        in_wrong_order = [each for each in episodes if not each["starts"].get(_IN_ORDER, True)]
        for name, part in ((RETURN_ALL, episodes), (RETURN_WRONG_ORDER, in_wrong_order)):
            if part:
                earned = Sample([each["episode_return"] for each in part], [each["expert_return"] for each in part])
                yield under(condition, name), earned


def _samples(found: Callable[[Trials], Iterator[tuple[str, Sample]]]) -> Callable[[Trials], Mapping[str, Sample]]:
    return lambda trials: dict(found(trials))


_REINFORCED = PolicyArm(_reinforce, _samples(_return_samples))
_FOLLOWER = PolicyArm(_follow, _samples(_landmark_samples))
_FOLLOWER_SHIFTED = PolicyArm(_follow_shifted, _samples(_landmark_samples))

METHODS: Mapping[str, PolicyArm] = MappingProxyType(
    {
        GOAL_CLONING: _FOLLOWER,
        GOAL_CLONING_AUGMENTED: _FOLLOWER_SHIFTED,
        GOAL_CONDITIONED: _FOLLOWER,
        SKILLS: PolicyArm(_execute_recipes, _samples(_recipe_samples)),
        SKILLS_AUGMENTED: PolicyArm(_execute_shifted_recipes, _samples(_recipe_samples)),
        EXPERT: PolicyArm(_expert_recipes, _samples(_recipe_samples)),
        PPO: _REINFORCED,
        PPO_AUGMENTED: _REINFORCED,
        PPO_NEAR: _REINFORCED,
        PPO_NEAR_CARRY: _REINFORCED,
        PPO_OWN_STARTS: _REINFORCED,
        PPO_PRACTICE: _REINFORCED,
        LANGUAGE: PolicyArm(language.obey, _samples(language.sentence_samples)),
        LANGUAGE_DONE: PolicyArm(language.say_when_done, _samples(language.done_samples)),
        LANGUAGE_DONE_AT_ONCE: PolicyArm(
            partial(language.say_when_done, reached_steps=1), _samples(language.done_samples)
        ),
    }
)
"""The recipe of each method's arms."""


def arms(seeds: int) -> tuple[Arm, ...]:
    """Returns the arms, each with so many seeds; those of PPO with more, and the expert with one."""
    fitted = (GOAL_CLONING, GOAL_CLONING_AUGMENTED, GOAL_CONDITIONED, SKILLS, SKILLS_AUGMENTED, LANGUAGE, LANGUAGE_DONE)
    return (
        Arm(DEMONSTRATED, EXPERT),
        Arm(DEMONSTRATED, LANGUAGE_DONE_AT_ONCE),
        *(Arm(DEMONSTRATED, method, seed=seed) for seed in range(seeds) for method in fitted),
        *(
            Arm(task, method, seed=seed)
            for method in _STARTS
            for seed in range(PPO_SEEDS)
            for task, seeds in zip((*SIDES, STACK), _SEEDS_OF.get(method, _ALL_SEEDS), strict=True)
            if seed in seeds
        ),
    )
