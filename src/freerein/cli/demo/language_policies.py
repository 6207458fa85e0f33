"""PPO on the learned reward, and distillation into one policy that is told in words what to do."""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from freerein.cli.demo import reward
from freerein.cli.demo.context import HELD_OUT_SEED, Context
from freerein.cli.demo.report import Figure, Returns

SIDES = ("left", "right")
TASKS = {side: f"blocks.yellow-{side}-of-green" for side in SIDES}
"""Task by side. The demo learns the left one by PPO: by true positions, the learned reward is precise for it."""

TEXTS = {side: f"a yellow block to the {side} of a green block" for side in SIDES}
"""Goal text by side."""

INIT_FROM = "yellow-left-of-green"
"""Shipped policy that PPO starts from: 100 iterations from random weights, on another learned reward."""

SHIPPED_TEACHERS = ("yellow-right-of-green",)
"""Shipped policies that teach beside the one that the demo learns."""

_RETURN = "episode_return"
_EPISODES, _ROLLOUTS, _UPDATES = 50, 50, 600
_PPO = {
    "task": TASKS["left"],
    "reward_model": reward.MODEL,
    "iterations": 40,
    "num_envs": 16,
    "num_steps": 32,
    "lr": 3e-4,
    "init_from": INIT_FROM,
}


@dataclass(frozen=True)
class PPOResult:
    """A trained policy.

    Attributes:
        run: Id of the run.
        curve: By iteration, the mean learned return of the episodes that ended in it.
        returns: Oracle returns.
        training_s: Duration in seconds.
    """

    run: str
    curve: tuple[tuple[int, float], ...]
    returns: Returns
    training_s: float


@dataclass(frozen=True)
class Student:
    """A policy that is told in words what to do.

    Attributes:
        returns: Oracle returns by the side of the task and the side that the student was told.
        training_s: Duration of rollouts and fit in seconds.
    """

    returns: Mapping[tuple[str, str], Returns]
    training_s: float

    @property
    def own_sentence(self) -> Returns:
        """Returns over both tasks, each told its own sentence."""
        return self.returns["left", "left"] + self.returns["right", "right"]

    @property
    def word_blind(self) -> Returns:
        """Returns over both tasks, always told the same sentence: the better of the two."""
        constant = [self.returns["left", told] + self.returns["right", told] for told in SIDES]
        return max(constant, key=lambda returns: returns.mean)


async def start_baselines(context: Context) -> str:
    """Starts to evaluate random actions in both tasks and the shipped policy in the left one; returns the run."""
    evaluations = {f"random-{side}": _evaluation(context, side, "random") for side in SIDES}
    evaluations["checkpoint"] = _evaluation(context, "left", {"stored": INIT_FROM, "stochastic": True})
    return await _start_evaluations(context, evaluations)


async def finish_baselines(context: Context, run: str) -> dict[str, Returns]:
    """Returns the returns of `random-left`, `random-right` and `checkpoint`."""
    return await _finish_evaluations(context, "evaluate baselines", run, "random-left", "random-right", "checkpoint")


async def learn_by_ppo(context: Context) -> PPOResult:
    """Trains a policy on images and the learned reward, and evaluates it."""
    context.reporter.line(f"PPO starts from {INIT_FROM}, which came with freerein.")
    started_s = time.perf_counter()
    run = await context.start_run("ppo", {**_PPO, "seed": context.seed})
    curves = await context.follow_run("ppo", run, metrics=(_RETURN,))
    training_s = time.perf_counter() - started_s
    evaluations = {"ppo": _evaluation(context, "left", {"run": run, "stochastic": True})}
    evaluation = await _start_evaluations(context, evaluations)
    returns = await _finish_evaluations(context, "evaluate ppo", evaluation, "ppo")
    return PPOResult(run, curves.points(_RETURN), returns["ppo"], training_s)


async def distill(context: Context, teacher: str) -> Student:
    """Distills the policy of a run and the shipped ones into one; evaluates each sentence in each task."""
    config = {
        "teachers": [teacher, *SHIPPED_TEACHERS],
        "rollouts": _ROLLOUTS,
        "num_envs": _ROLLOUTS,
        "stochastic": False,  # the student would have to average noise away
        "seed": context.seed,
        "config": {"steps": _UPDATES},
    }
    started_s = time.perf_counter()
    run = await context.start_run("distill", config)
    await context.follow_run("distill", run, metrics=("fit/train_loss",))
    training_s = time.perf_counter() - started_s
    names = {f"{side}-told-{told}": (side, told) for side in SIDES for told in SIDES}
    evaluations = {
        name: _evaluation(context, side, {"run": run, "goal_text": TEXTS[told]}) for name, (side, told) in names.items()
    }
    evaluation = await _start_evaluations(context, evaluations)
    returns = await _finish_evaluations(context, "evaluate the student", evaluation, *evaluations)
    return Student({names[name]: found for name, found in returns.items()}, training_s)


async def _start_evaluations(context: Context, evaluations: Mapping[str, dict[str, Any]]) -> str:
    """Starts a pipeline of evaluations; returns the run."""
    steps = [{"name": name, "kind": "evaluate", "config": config} for name, config in evaluations.items()]
    return await context.start_run("pipeline", {"steps": steps})


async def _finish_evaluations(context: Context, title: str, run: str, *names: str) -> dict[str, Returns]:
    """Returns the results of a pipeline's evaluations by name, once it has ended."""
    await context.follow_run(title, run)
    results = {name: await context.artifact(run, f"{name}.result.json") for name in names}
    return {name: Returns(tuple(result["returns"])) for name, result in results.items()}


def _evaluation(context: Context, side: str, policy: str | dict[str, Any]) -> dict[str, Any]:
    seed = context.seed + HELD_OUT_SEED
    return {"task": TASKS[side], "policy": policy, "episodes": _EPISODES, "num_envs": _EPISODES, "seed": seed}


def returns_by_panel(
    baselines: Mapping[str, Returns], ppo: PPOResult, student: Student
) -> dict[str, Mapping[str, Returns]]:
    """Returns what the picture compares: returns by policy, by the title of their panel."""
    told = {
        side: {f'student,\ntold "{told}"': student.returns[side, told] for told in sorted(SIDES, key=side.__ne__)}
        for side in SIDES
    }
    left = {"random": baselines["random-left"], "checkpoint": baselines["checkpoint"], "ppo": ppo.returns}
    return {
        "left-of: steps at the goal": {**left, **told["left"]},
        "right-of: steps at the goal": {"random": baselines["random-right"], **told["right"]},
    }


def figures(baselines: Mapping[str, Returns], ppo: PPOResult, student: Student) -> tuple[Figure, ...]:
    """Returns the figures of PPO and of distillation; returns are control steps of 100 at the goal."""
    checkpoint, right, blind = baselines["checkpoint"], student.own_sentence, student.word_blind
    told = [
        _figure(f"distill.{side}_of.told_{told}", returns, baselines[f"random-{side}"].mean, "random actions")
        for (side, told), returns in student.returns.items()
    ]
    return (
        _figure("ppo.checkpoint_return", checkpoint, baselines["random-left"].mean, "random actions"),
        _figure("ppo.return", ppo.returns, checkpoint.mean, "shipped checkpoint"),
        _figure("ppo.gain_since_checkpoint", ppo.returns - checkpoint, 0.0, "no gain", beats_baseline=True),
        *told,
        _figure("distill.own_sentence_return", right, blind.mean, "one constant sentence"),
        _figure("distill.gain_by_words", right - blind, 0.0, "word-blind", beats_baseline=True),
        Figure("ppo.training_s", ppo.training_s),
        Figure("distill.training_s", student.training_s),
    )


def _figure(
    name: str, returns: Returns, baseline: float, baseline_text: str, *, beats_baseline: bool = False
) -> Figure:
    return Figure(name, returns.mean, baseline, baseline_text, returns.interval, beats_baseline=beats_baseline)
