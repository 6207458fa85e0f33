"""The pipeline, as data: what is recorded, fitted, labelled, evaluated, trained and distilled.

A step that evaluates is named after what it measures; `figures.py` reads its result by that name.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from experiments.workbench.pipelines import Step, step
from freerein.cli.demo.learning import GRID_DEMONSTRATIONS, GRID_FIT, ITERATIONS, PPO, UNTRAINED
from freerein.cli.demo.parts import HELD_OUT_SEED

SIDES = ("left", "right")
TASKS = {side: f"blocks.yellow-{side}-of-green" for side in SIDES}
"""Task by side. The left one is learned by PPO."""

TEXTS = {side: f"a yellow block to the {side} of a green block" for side in SIDES}
"""Goal text of each task, by side."""

SHIPPED_TEACHERS = ("yellow-right-of-green",)
"""Shipped policies that teach beside the one that PPO learns."""

FULL, SMALL = "full", "small"

_SMALL_PPO = {"explorations": 2, "num_steps": 32}
_SMALLER: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        "grid-demos": {"count": 60},
        "blocks-demos": {"count": 40},
        "exploration": {"count": 40},
        "scatter": {"count": 60},
        "fit-grid": {"config": {"steps": 20}},
        "fit-blocks": {"config": {"steps": 20}},
        "fit-rewards": {"config": {"steps": 20}},
        "fit-goal-images": {"config": {"steps": 20}},
        "fit-skills": {"config": {"steps": 20}},
        "grid-labels": {"episodes": 8},
        "blocks-labels": {"episodes": 8},
        "two-blocks": {"episodes": 16, "num_envs": 16},
        "four-blocks": {"episodes": 16, "num_envs": 16},
        "landmarks": {"episodes": 8, "num_envs": 8},
        "random-left": {"episodes": 8, "num_envs": 8},
        "random-right": {"episodes": 8, "num_envs": 8},
        "recipes": {"episodes": 4, "num_envs": 4},
        "ppo-first": _SMALL_PPO,
        "ppo": {**_SMALL_PPO, "iterations": 2},
        "ppo-returns": {"episodes": 8, "num_envs": 8},
        "distill": {"rollouts": 4, "num_envs": 4, "config": {"steps": 20}},
        "sentences": {"episodes": 4, "num_envs": 4},
    }
)
"""Overrides of the small size, by step: every kind of work in two minutes, and figures that mean nothing."""

_REWARD_MODEL = "first-blocks"
_PHRASES = [f"a {colour} block" for colour in ("red", "green", "yellow", "blue")]
_BLOCK = 0.105
"""Width of a block's front in the frames of the camera `front`, as a share of theirs."""

_EPISODES, _SENTENCE_EPISODES = 50, 32


def pipeline(size: str, seed: int) -> list[Step]:
    """Returns the steps in a size; fits begin as soon as their data is there."""
    steps = [*_learn_from_data(), *_evaluate_and_practise()]
    return [_seeded(_sized(each, size), seed) for each in steps]


def _learn_from_data() -> list[Step]:
    """The steps that record, and fit models to the records."""
    return [
        _collect("grid-demos", behaviour="expert", **GRID_DEMONSTRATIONS),
        _collect("blocks-demos", task="blocks", behaviour="expert", count=400, min_skills=2, max_skills=3),
        _collect("exploration", task="blocks", behaviour="random", count=400),
        _collect("scatter", task="blocks.scatter", behaviour="random", count=1000),
        _fit("fit-grid", "segmentation", "first-grid", "grid-demos", **GRID_FIT),
        _evaluate("grid-labels", "segmentation", task="grid", model="first-grid", episodes=100, **_skills(5)),
        _fit("fit-blocks", "segmentation", "first-blocks", "blocks-demos", stride=3, steps=1200, augmentation=0.0),
        step("label-blocks", "label", dataset="blocks-demos", model="first-blocks", smoothing=1),
        _evaluate("blocks-labels", "segmentation", task="blocks", model="first-blocks", episodes=60, **_skills(4)),
        _fit("fit-rewards", "reward", _REWARD_MODEL, "scatter", phrases=_PHRASES, epsilon=_BLOCK),
        _scenes("two-blocks", "blocks-2"),
        _scenes("four-blocks", "blocks-4"),
        _fit(
            "fit-goal-images",
            "imitation",
            "first-goals",
            "exploration",
            method="goal_cloning",
            features=80,
            steps=1500,
            augmentation=0.0,
            normalise_exposure=False,
        ),
    ]


def _evaluate_and_practise() -> list[Step]:
    """The steps that evaluate policies, and train by PPO and distillation."""
    own, other = TASKS.values()
    return [
        _evaluate("landmarks", "landmarks", task="blocks", policy={"model": "first-goals"}, episodes=64, num_envs=64),
        _returns("random-left", own, "random"),
        _returns("random-right", other, "random"),
        _fit(
            "fit-skills",
            "imitation",
            "first-skills",
            "blocks-demos",
            after="label-blocks",
            method="skills",
            augmentation=0.0,
            normalise_exposure=False,
        ),
        _evaluate("recipes", "recipes", task="blocks", policy={"model": "first-skills"}, episodes=40, num_envs=40),
        _ppo("ppo-first", own, **UNTRAINED),
        _ppo("ppo", own, iterations=ITERATIONS, init_from="ppo-first"),
        _returns("ppo-returns", own, {"run": "ppo"}, baseline={"run": "ppo-first"}),
        step(
            "distill",
            "distill",
            teachers=["ppo", *SHIPPED_TEACHERS],
            dagger_iterations=1,
            num_envs=50,
            config={"steps": 800, "reached_weight": 0.0},
        ),
        _evaluate(
            "sentences",
            "sentences",
            task=own,
            other_tasks=[other],
            policy={"run": "distill"},
            episodes=_SENTENCE_EPISODES,
            num_envs=_SENTENCE_EPISODES,
        ),
    ]


def _collect(name: str, **config: Any) -> Step:
    return step(name, "collect", dataset=name, **config)


def _fit(name: str, service: str, model: str, data: str, *, after: str = "", **config: Any) -> Step:
    """A fit that begins once the step that collects its data, or the step `after`, is done."""
    made = step(name, "fit", service=service, dataset=data, model_name=model, config=config)
    return {**made, "after": [after or data]}


def _evaluate(name: str, form: str, **config: Any) -> Step:
    return step(name, "evaluate", form=form, **config)


def _ppo(name: str, task: str, **config: Any) -> Step:
    """PPO from random weights, on the reward that was learned."""
    return step(name, "ppo", task=task, reward_model=_REWARD_MODEL, augmentation=0.0, **PPO, **config)


def _scenes(name: str, condition: str) -> Step:
    return _evaluate(
        name,
        "relations",
        task="blocks.scatter",
        conditions=[condition],
        model=_REWARD_MODEL,
        episodes=320,
        num_envs=64,
    )


def _returns(name: str, task: str, policy: str | dict[str, Any], **config: Any) -> Step:
    return _evaluate(name, "returns", task=task, policy=policy, episodes=_EPISODES, num_envs=_EPISODES, **config)


def _skills(count: int) -> dict[str, Any]:
    """Demonstrations with more different skills than any that the model has seen."""
    return {"min_skills": count, "max_skills": count, "smoothing": 1}


def _sized(made: Step, size: str) -> Step:
    """Returns a step in a size."""
    smaller = _SMALLER.get(made["name"], {}) if size == SMALL else {}
    config = {**made["config"], **smaller}
    if "config" in smaller:  # of the fit
        config["config"] = {**made["config"]["config"], **smaller["config"]}
    return {**made, "config": config}


def _seeded(made: Step, seed: int) -> Step:
    """Returns a step with the seed of its kind."""
    config = made["config"]
    match made["kind"]:
        case "fit":
            seeded = {**config, "config": {**config["config"], "seed": seed}}
        case "evaluate":
            seeded = {**config, "seed": seed + HELD_OUT_SEED}
        case "label":
            seeded = config
        case _:
            seeded = {**config, "seed": seed}
    return {**made, "config": seeded}
