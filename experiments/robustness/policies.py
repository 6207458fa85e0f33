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
from experiments.robustness.worlds import CURRICULUM, DEMONSTRATED, NOMINAL
from experiments.workbench.arms import Arm
from experiments.workbench.pipelines import Step, Trials, fit_step, step
from experiments.workbench.results import Outcome, Sample

FLAG_AUROC, FLAG_ECE, FLAG_RECALL = "flag.auroc", "flag.ece", "flag.recall"
LANDMARKS_FREE, LANDMARKS_BLOCK = "landmarks.free", "landmarks.block"
RECIPE_SKILLS, RECIPE_WHOLE = "recipe.skills", "recipe.whole"
RECIPE_OF_NOMINAL = "recipe.of-nominal"
"""Skills that are completed under a condition, as a share of those that are completed nominally."""
RETURN_ALL, RETURN_WRONG_ORDER = "return.all", "return.wrong-order"
TOLD_OWN, WORDINGS = "told.own", "told.wordings"

GOAL_CLONING, GOAL_CLONING_AUGMENTED, GOAL_CONDITIONED = "goal_cloning", "goal_cloning_augmented", "goal_conditioned"
SKILLS, SKILLS_AUGMENTED, EXPERT = "skills", "skills_augmented", "expert"
PPO, PPO_OWN_STARTS, PPO_PRACTICE = "ppo_training", "ppo_own_starts", "ppo_practice"
PPO_AUGMENTED = "ppo_augmented"
LANGUAGE, PPO_SPEED = "language", "ppo_speed"

SIDES = ("blocks.yellow-left-of-green", "blocks.yellow-right-of-green")
STACK = "blocks.yellow-on-top-of-green"
PPO_SEEDS, SPEED_RUNS = 5, 9
TEACHERS = ("yellow-left-of-green", "yellow-right-of-green")
"""Shipped policies, from which a language policy is distilled."""

WORDINGS_OF_SIDES = tuple(
    wording.format(side=side, other=other)
    for side, other in (("left", "right"), ("right", "left"))
    for wording in (
        "I want the yellow block {side} of the green one",
        "could you place the yellow cube to the {side} of the green cube?",
        "Arrange the blocks so that yellow is {side} of green!",
        "A green block to the {other} of a yellow block",
        "slide the green one to the {other} of the yellow one",
    )
)
"""Wordings and converses, of the left, then of the right; none is a goal text that a policy is trained on.

The random texts that train the text reader have `yellow`, `green`, `block`, and the wordings of relations. Held out are
verbs (`want`, `arrange`, `slide`), the sentences around a statement (`could you`, `so that`), and `cube`. The converse
without a verb has nothing that is held out.
"""

_HELD_OUT_SEED = 1_000_003
_LABEL_STEPS = 4000
"""Twice the default: with tags of two or three skills, a fit may confuse two of four for 1 500 steps."""

_STARTS: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        PPO: {"conditions": [CURRICULUM], "augmentation": 0.0},
        PPO_AUGMENTED: {"conditions": [CURRICULUM]},
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
_SENTENCE_EPISODES = 32
_NUM_ENVS = 64
_IN_ORDER = "start/in-order"
_PRECISION = 0.9
_STUDENT, _WORD_BLIND = "student", "word-blind"


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
    return _evaluate(
        form, _step_name(form, condition), task=DEMONSTRATED, policy=policy, episodes=episodes, **conditions
    )


def _step_name(form: str, condition: str) -> str:
    return form if condition == NOMINAL else f"{form}-{condition.replace('.', '')}"


def under(condition: str, figure: str) -> str:
    """Returns the name of a figure under a condition."""
    return figure if condition == NOMINAL else f"{condition}.{figure}"


def _expert_recipes(arm: Arm) -> list[Step]:
    return [_evaluate("recipes", task=arm.world, policy="expert", episodes=_RECIPES)]


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
    return _evaluate(
        "returns", name, task=arm.world, policy=policy, baseline="random", episodes=_RETURN_EPISODES, **more
    )


def _obey(arm: Arm) -> list[Step]:
    left, right = SIDES
    told = {"task": left, "other_tasks": [right], "other_texts": list(WORDINGS_OF_SIDES)}
    return [
        *(
            step(
                name,
                "distill",
                teachers=list(TEACHERS),
                rollouts=100,
                dagger_iterations=3,
                num_envs=50,
                model_name=name,
                seed=arm.seed,
                config={"seed": arm.seed, "conditioning": "none" if name == _WORD_BLIND else "text"},
            )
            for name in (_STUDENT, _WORD_BLIND)
        ),
        *(
            _evaluate("sentences", _told(name), policy={"run": name}, episodes=_SENTENCE_EPISODES, **told)
            for name in (_STUDENT, _WORD_BLIND)
        ),
        *(
            _evaluate("returns", teacher, task=task, policy={"stored": teacher}, episodes=_SENTENCE_EPISODES)
            for task, teacher in zip(SIDES, TEACHERS, strict=True)
        ),
    ]


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
        yield name, Sample.of_flags([flags[keep] for flags, keep in zip(recognized, kept, strict=True)])


def _recall(score: npt.NDArray[np.float64], right: npt.NDArray[np.bool_], trial: npt.NDArray[np.int64]) -> Sample:
    """Returns the recall at the lowest threshold whose precision is high enough; the interval holds it fixed."""
    order = np.argsort(-score, kind="stable")
    last = np.append(np.diff(score[order]) < 0, True)  # equal scores are above a threshold together
    precision = np.cumsum(right[order]) / np.arange(1, len(order) + 1)
    enough = np.flatnonzero((precision >= _PRECISION) & last)
    threshold = score[order][enough[-1]] if len(enough) else np.inf
    return confidence.by_trial((score >= threshold) & right, right, trial)


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


def _sentence_samples(trials: Trials) -> Iterator[tuple[str, Sample]]:
    """Yields the student's return as a share of its teachers', and what was done told wordings, by trial.

    Of each task also the return of the word-blind student, that of ours told the other task, and the difference.
    """
    student, word_blind = (trials[_told(name)] for name in (_STUDENT, _WORD_BLIND))
    taught = [[each["episode_return"] for each in trials[name]] for name in TEACHERS]
    own = [sum(each["returns"][task][task] for task in range(len(SIDES))) for each in student]
    yield TOLD_OWN, Sample(own, [sum(each) for each in zip(*taught, strict=True)])
    for task, name in enumerate(SIDES):
        other = 1 - task
        blind = [each["returns"][task][task] for each in word_blind]
        misled = [each["returns"][task][other] for each in student]
        losses = [one - another for one, another in zip(blind, misled, strict=True)]
        named = {told_other(name): losses, word_blind_return(name): blind, told_other_return(name): misled}
        yield from ((figure, Sample(each, [1] * len(each))) for figure, each in named.items())
    count = len(WORDINGS_OF_SIDES)
    meant = np.arange(count) >= count // 2  # the left task's, then the right one's
    done = [np.array(each["successes"])[meant.astype(int), len(SIDES) + np.arange(count)] for each in student]
    yield WORDINGS, Sample.of_flags(done)


def told_other(task: str) -> str:
    """Returns the name of a figure: the word-blind student's return in a task less that of ours, told the other."""
    return f"told.other.{task}"


def word_blind_return(task: str) -> str:
    """Returns the name of a figure: the word-blind student's return in a task."""
    return f"told.blind.{task}"


def told_other_return(task: str) -> str:
    """Returns the name of a figure: our student's return in a task, told the other."""
    return f"told.misled.{task}"


def _evaluate(form: str, name: str = "", **config: Any) -> Step:
    return step(name or form, "evaluate", form=form, num_envs=_NUM_ENVS, seed=_HELD_OUT_SEED, **config)


def _told(student: str) -> str:
    return f"{student}-told"


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
        PPO_OWN_STARTS: _REINFORCED,
        PPO_PRACTICE: _REINFORCED,
        LANGUAGE: PolicyArm(_obey, _samples(_sentence_samples)),
    }
)
"""How arms are made, by method."""


def arms(seeds: int) -> tuple[Arm, ...]:
    """Returns the arms, each with so many seeds; those of PPO with more, and the expert with one."""
    fitted = (GOAL_CLONING, GOAL_CLONING_AUGMENTED, GOAL_CONDITIONED, SKILLS, SKILLS_AUGMENTED, LANGUAGE)
    return (
        Arm(DEMONSTRATED, EXPERT),
        *(Arm(DEMONSTRATED, method, seed=seed) for seed in range(seeds) for method in fitted),
        *(Arm(task, method, seed=seed) for method in _STARTS for seed in range(PPO_SEEDS) for task in (*SIDES, STACK)),
    )
