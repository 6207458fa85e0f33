"""The pipeline of the demo, as data: what is recorded, fitted, labelled, evaluated, trained and distilled.

A step that evaluates is named after what it measures; `figures.py` and `results.py` read its result by that name.
"""

from typing import Any

HELD_OUT_SEED = 1_000_000
"""Added to the seed for evaluations."""

SIDES = ("left", "right")
TASKS = {side: f"blocks.yellow-{side}-of-green" for side in SIDES}
"""Task by side. The demo learns the left one by PPO."""

TEXTS = {side: f"a yellow block to the {side} of a green block" for side in SIDES}
"""Goal text of each task, by side."""

SHIPPED_TEACHERS = ("yellow-right-of-green",)
"""Shipped policies that teach beside the one that the demo learns."""

_PREFIX = "demo-"
"""Of all datasets and models, which may be stored beside a user's own and those that come with freerein."""

REWARD_MODEL = f"{_PREFIX}blocks"
PHRASES = [f"a {colour} block" for colour in ("red", "green", "yellow", "blue")]
"""Noun phrases of the reward model."""

_BLOCK = 0.105
"""Width of a block's front in the frames of the camera `front`, as a share of theirs."""

_EPISODES, _SENTENCE_EPISODES = 50, 32

_ITERATIONS = 47
"""Half of the default, for the demo's two minutes: 96 256 control ticks."""

_NO_LR = 1e-7
"""The smallest learning rate, which changes nothing: the policy with an eye and random weights that PPO begins with."""

Step = dict[str, Any]


def pipeline(seed: int) -> dict[str, Any]:
    """Returns the configuration of the demo's run of kind `pipeline`; fits begin as soon as their data is there."""
    steps = [*_learn_from_data(), *_evaluate_and_practise()]
    return {"steps": [{**step, "config": _seeded(step, seed)} for step in steps]}


def _learn_from_data() -> list[Step]:
    """What is recorded, and the models that learn from it."""
    return [
        _collect("grid-demos", task="grid", behaviour="expert", count=1000, min_skills=2, max_skills=4),
        _collect("blocks-demos", task="blocks", behaviour="expert", count=400, min_skills=2, max_skills=3),
        _collect("exploration", task="blocks", behaviour="random", count=400),
        _collect("scatter", task="blocks.scatter", behaviour="random", count=1000),
        _fit("fit-grid", "segmentation", "grid", "grid-demos", steps=300, batch_size=16, augmentation=0.0),
        _evaluate("grid-labels", "segmentation", task="grid", model=f"{_PREFIX}grid", episodes=100, **_skills(5)),
        _fit("fit-blocks", "segmentation", "blocks", "blocks-demos", stride=3, steps=1200, augmentation=0.0),
        _step("label-blocks", "label", dataset=f"{_PREFIX}blocks-demos", model=f"{_PREFIX}blocks", smoothing=1),
        _evaluate("blocks-labels", "segmentation", task="blocks", model=f"{_PREFIX}blocks", episodes=60, **_skills(4)),
        _fit("fit-rewards", "reward", "blocks", "scatter", phrases=PHRASES, epsilon=_BLOCK),
        _scenes("two-blocks", "blocks-2"),
        _scenes("four-blocks", "blocks-4"),
        _fit("fit-goal-images", "imitation", "goal-images", "exploration", method="goal_cloning", steps=1500),
    ]


def _evaluate_and_practise() -> list[Step]:
    """What is measured of the policies, and PPO and distillation."""
    own, other = TASKS.values()
    return [
        _evaluate(
            "landmarks", "landmarks", task="blocks", policy={"model": f"{_PREFIX}goal-images"}, episodes=64, num_envs=64
        ),
        _returns("random-left", own, "random"),
        _returns("random-right", other, "random"),
        _fit("fit-skills", "imitation", "skills", "blocks-demos", after="label-blocks", method="skills"),
        _evaluate("recipes", "recipes", task="blocks", policy={"model": f"{_PREFIX}skills"}, episodes=40, num_envs=40),
        _ppo("ppo-first", own, iterations=1, lr=_NO_LR),
        _ppo("ppo", own, iterations=_ITERATIONS, init_from="ppo-first"),
        _returns("ppo-returns", own, {"run": "ppo"}, baseline={"run": "ppo-first"}),
        _step(
            "distill",
            "distill",
            teachers=["ppo", *SHIPPED_TEACHERS],
            dagger_iterations=1,
            num_envs=50,
            config={"steps": 800},
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


def _step(name: str, kind: str, **config: Any) -> Step:
    return {"name": name, "kind": kind, "config": config}


def _collect(name: str, **config: Any) -> Step:
    return _step(name, "collect", dataset=_PREFIX + name, **config)


def _fit(name: str, service: str, model: str, data: str, *, after: str = "", **config: Any) -> Step:
    """A fit that begins once the step that collects its data, or the step `after`, is done."""
    names = {"dataset": _PREFIX + data, "model_name": _PREFIX + model}
    return {**_step(name, "fit", service=service, **names, config=config), "after": [after or data]}


def _evaluate(name: str, form: str, **config: Any) -> Step:
    return _step(name, "evaluate", form=form, **config)


def _ppo(name: str, task: str, **config: Any) -> Step:
    """PPO from random weights, on the reward that the demo has learned."""
    return _step(name, "ppo", task=task, reward_model=REWARD_MODEL, conditions=["start-on-the-way"], **config)


def _scenes(name: str, condition: str) -> Step:
    return _evaluate(
        name,
        "relations",
        task="blocks.scatter",
        conditions=[condition],
        model=REWARD_MODEL,
        episodes=320,
        num_envs=64,
    )


def _returns(name: str, task: str, policy: str | dict[str, Any], **config: Any) -> Step:
    return _evaluate(name, "returns", task=task, policy=policy, episodes=_EPISODES, num_envs=_EPISODES, **config)


def _skills(count: int) -> dict[str, Any]:
    """Demonstrations with more different skills than any that the model has seen."""
    return {"min_skills": count, "max_skills": count, "smoothing": 1}


def _seeded(step: Step, seed: int) -> dict[str, Any]:
    """Returns a step's configuration with the seed of its kind."""
    config: dict[str, Any] = step["config"]
    match step["kind"]:
        case "fit":
            return {**config, "config": {**config["config"], "seed": seed}}
        case "evaluate":
            return {**config, "seed": seed + HELD_OUT_SEED}
        case "label":
            return config
    return {**config, "seed": seed}
