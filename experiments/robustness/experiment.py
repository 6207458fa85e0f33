"""The benchmark's arms: models and guesses of the world `blocks`, each evaluated under all of its conditions."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import torch

from experiments.robustness import (
    criteria,
    goal_texts,
    language,
    policies,
    report,
    reward_model,
    scenes,
    segmentation,
    speed,
    unfamiliar,
    visited_states,
    wordings,
)
from experiments.robustness.draw import Scenes, Spec, open_or_draw
from experiments.robustness.targets import OURS
from experiments.robustness.visited_states import StoredPolicy, stored_policies
from experiments.robustness.worlds import DEMONSTRATED, NOMINAL, SCATTERED
from experiments.segmentation import guesses
from experiments.workbench.arms import Arm, Experiment
from experiments.workbench.configs import Config
from experiments.workbench.pipelines import run_pipeline
from experiments.workbench.results import ArmResult, Outcome
from experiments.workbench.table import Table
from freerein_reward.methods.relation_captions.config import RewardConfig
from freerein_reward.model import DualEncoderModel
from freerein_segmentation.training import SegmentationConfig

AUGMENTATION: Mapping[str, float] = MappingProxyType({"augmented": 1.0, "plain": 0.0})
"""Strength of the camera augmentation of a fit, by variant; the first is the library's default."""

SEGMENTATION, REWARD, PPO, UNFAMILIAR = "segmentation", "reward", "ppo", unfamiliar.METHOD

_MORE_REWARDS = (criteria.METHOD, visited_states.METHOD)

_VERSION = 1
"""Of the evaluation; a new one replaces all results."""

_FOUND: Mapping[tuple[str, str], Callable[[Path], Outcome]] = MappingProxyType(
    {
        (DEMONSTRATED, "random"): lambda work: segmentation.evaluate_guess(guesses.guess_skill, work),
        (DEMONSTRATED, "majority"): lambda work: segmentation.evaluate_guess(guesses.guess_majority, work),
        (SCATTERED, "majority"): scenes.evaluate_majority,
        (SCATTERED, "word_blind"): scenes.evaluate_word_blind,
        (SCATTERED, "captions"): scenes.evaluate_captions,
        (SCATTERED, goal_texts.TEXTS): lambda work: goal_texts.evaluate(),
    }
)
"""Evaluations without a fit, by world and method."""


@dataclass(frozen=True)
class RobustnessExperiment(Experiment):
    """Arms that differ in model, augmentation and seed.

    Attributes:
        seeds: Number of independently trained networks of each kind.
        policies: Folder of the orchestrator's policies: those that a language policy is distilled from, and the
            teachers of chapter 4, each by the name of its task. Only final policies ship, so that the reward is judged
            on their states.
    """

    seeds: int = 3
    policies: Path = Path("models/orchestrator")

    @property
    def arms(self) -> tuple[Arm, ...]:
        """Guesses, then all fits of a variant, policies that ship, policies that are trained, and a speed."""
        tasks = sorted(self._policies)
        fitted = ((DEMONSTRATED, SEGMENTATION), (SCATTERED, REWARD), *((task, REWARD) for task in tasks))
        return (
            *(Arm(world, method) for world, method in _FOUND),
            *(
                Arm(world, method, {"fit": variant}, seed)
                for variant in AUGMENTATION
                for world, method in fitted
                for seed in range(self.seeds)
            ),
            *(Arm(world, UNFAMILIAR, {}, seed) for world in (DEMONSTRATED, SCATTERED) for seed in range(self.seeds)),
            *(Arm(SCATTERED, method, {}, seed) for method in _MORE_REWARDS for seed in range(self.seeds)),
            *(Arm(task, PPO) for task in tasks),
            *policies.arms(self.seeds),
            *(Arm(language.SIDES[0], policies.PPO_SPEED, seed=run) for run in range(policies.SPEED_RUNS)),
        )

    @property
    def _policies(self) -> dict[str, StoredPolicy]:
        stored = stored_policies(self.policies)
        return {policy.task: policy for policy in stored if policy.name in language.TEACHERS}

    @property
    def _teachers(self) -> list[StoredPolicy]:
        return [policy for policy in stored_policies(self.policies) if policy.name == policy.task]

    def config(self, arm: Arm) -> Config:
        """Returns the specs of all data, the service's configuration of a fit, and the policy that acts."""
        config: dict[str, object] = {"version": _VERSION}
        if arm.method == policies.LANGUAGE:
            config["teachers"] = list(self._policies.values())
        if arm.method == policies.PPO_SPEED:
            return config | {"speed": speed.VERSION}
        if arm.method == goal_texts.TEXTS:
            return config | {"reward_model": goal_texts.reward_version()}
        if arm.method in policies.METHODS:
            return config | {"steps": list(policies.METHODS[arm.method].steps(arm))}
        if arm.method == criteria.METHOD:
            fit, test = criteria.fit_config(seed=arm.seed), list(unfamiliar.scene_specs().values())
            more = {"training": reward_model.TRAINING, "grounding": reward_model.grounding_version()}
            return config | more | {"fit": fit, "test": test}
        if _segments(arm):
            config |= {"fit": _segmentation_config(arm), "training": segmentation.TRAINING}
        if _rewards(arm):
            config |= {"fit": _reward_config(arm), "training": reward_model.TRAINING}
        if _rewards(arm) or arm.method == "captions":
            config["grounding"] = reward_model.grounding_version()
        if arm.method == UNFAMILIAR:
            config["effects"] = list(unfamiliar.EFFECTS)
        return config | {"test": self._test(arm)}

    def _test(self, arm: Arm) -> object:
        """Returns the specs of what an arm is evaluated on."""
        if arm.world == DEMONSTRATED:
            return segmentation.test_specs()
        if arm.method == visited_states.METHOD:
            return [visited_states.rollouts(each, NOMINAL) for each in self._teachers]
        if arm.world == SCATTERED:
            return list(_scenes(arm).values())
        return visited_states.rollouts(self._policies[arm.world], NOMINAL)

    def prepare(self, arm: Arm, work: Path) -> bool:
        """Draws what is learned from and what fits are evaluated on; pipelines draw their own, and texts need none."""
        if arm.method in (*policies.METHODS, policies.PPO_SPEED, goal_texts.TEXTS):
            return True
        specs = (segmentation.TRAINING, *segmentation.test_specs().values())
        more: tuple[Spec, ...] = (reward_model.TRAINING, *unfamiliar.scene_specs().values())
        for spec in (*specs, *more):
            open_or_draw(spec, work)
        return True

    def run(
        self, arm: Arm, *, results: Path, work: Path, folder: Path, on_progress: Callable[[], None]
    ) -> Outcome | None:
        """Fits where no other arm has, and evaluates; see `Experiment`. Checkpoints are in `work`."""
        if arm.method in policies.METHODS:
            return _train_policy(arm, folder, on_progress)
        if arm.method == policies.PPO_SPEED:
            return speed.evaluate()
        torch.set_num_threads(1)
        if found := _FOUND.get((arm.world, arm.method)):
            return found(work)
        if _segments(arm):
            segmenter = segmentation.fit_model(_segmentation_config(arm), work, on_progress)
            evaluate = unfamiliar.evaluate_segmentation if arm.method == UNFAMILIAR else segmentation.evaluate
            return None if segmenter is None else evaluate(segmenter, work)
        if arm.method == PPO:
            return visited_states.evaluate_policy(self._policies[arm.world], work)
        return self._fit_reward(arm, work, on_progress)

    def _fit_reward(self, arm: Arm, work: Path, on_progress: Callable[[], None]) -> Outcome | None:
        if arm.method == criteria.METHOD:
            of_criteria = criteria.fit_model(criteria.fit_config(seed=arm.seed), work, on_progress)
            return None if of_criteria is None else criteria.evaluate(of_criteria, work)
        model = reward_model.fit_model(_reward_config(arm), work, on_progress)
        return None if model is None else self._judge(model, arm, work)

    def _judge(self, model: DualEncoderModel, arm: Arm, work: Path) -> Outcome:
        """Returns the figures of a reward model."""
        if arm.world != SCATTERED:
            return visited_states.evaluate(model, self._policies[arm.world], work)
        if arm.method == visited_states.METHOD:
            return visited_states.evaluate_all(model, self._teachers, work)
        if arm.method == UNFAMILIAR:
            return unfamiliar.evaluate_reward(model, work)
        parts = [scenes.evaluate(model, work), wordings.evaluate(model, work)]
        return Outcome({}, {name: sample for part in parts for name, sample in part.samples.items()})

    def table(self, results: Sequence[ArmResult]) -> Table:
        """Returns the table of the arms that have results."""
        return report.table(results)


def _train_policy(arm: Arm, folder: Path, on_progress: Callable[[], None]) -> Outcome | None:
    made = policies.METHODS[arm.method]
    trials = run_pipeline(made.steps(arm), folder, on_progress)
    return None if trials is None else made.outcome(trials)


def _segments(arm: Arm) -> bool:
    return arm.method == SEGMENTATION or (arm.method, arm.world) == (UNFAMILIAR, DEMONSTRATED)


def _rewards(arm: Arm) -> bool:
    return arm.method in (REWARD, visited_states.METHOD) or (arm.method, arm.world) == (UNFAMILIAR, SCATTERED)


def _scenes(arm: Arm) -> Mapping[tuple[str, str], Scenes]:
    return unfamiliar.scene_specs() if arm.method == UNFAMILIAR else scenes.scene_specs()


def _segmentation_config(arm: Arm) -> SegmentationConfig:
    return segmentation.fit_config(augmentation=_augmentation(arm), seed=arm.seed)


def _reward_config(arm: Arm) -> RewardConfig:
    return reward_model.fit_config(augmentation=_augmentation(arm), seed=arm.seed)


def _augmentation(arm: Arm) -> float:
    """Returns the strength of an arm's augmentation; of one without variants, the library's default."""
    return AUGMENTATION[arm.options.get("fit", OURS)]
