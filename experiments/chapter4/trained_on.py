"""Policies that PPO trains on one of several rewards, in the tasks of figure 4.6 and in the pendulum of figure 4.4."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import torch

from experiments.robustness.evaluated import evaluate
from experiments.robustness.worlds import CAMERA, NEAR
from experiments.workbench.arms import Arm
from experiments.workbench.pipelines import Step, Trials, step
from experiments.workbench.results import Sample
from freerein.data import Dataset, dataset_path
from freerein.types.common import Camera
from freerein_orchestrator.rewards.vice import SuccessClassifier, examples, fit

LEARNED, ORACLE, BASE, RULE, VICE = "learned", "oracle", "base", "rule", "vice"
CURIOSITY, CONSTANT, ALIVE = "curiosity", "constant", "alive"
PUSH, STACK, PLACE = "push", "blocks.yellow-on-top-of-red", "blocks.yellow-right-of-red"
PENDULUM = "pendulum"

OURS, DISSERTATION = "ours", "dissertation"
TUNING = "tuning"
RETURN, POINTS, RANDOM = "return", "points", "random"

TOLD_SUCCESS, TOLD_FAILURE = "told-success", "told-failure"
"""Shares of held-out frames of success, and of failure, that the classifier of `vice` tells as what they are."""

_PPO, _RETURNS, _WON, _HELD_OUT = "ppo", "returns", "won", "won-held-out"
_IMAGES_OF_PUCKS, _REWARD = "images", "reward"
_HELD_OUT_SUCCESSES, _HELD_OUT_SEED = 50, 1_000_004
_EPISODES, _IMAGES, _IMAGE_STEPS, _SUCCESSES = 100, 1000, 6, 100
_SETTLE = 2
_TICKS = 200_000
_PUCK_WIDTH, _PUCK_DEPTH = 0.117, 0.072
"""Of a frame of the front camera, which looks down at the table: it is the front view, and the tilted one."""

PUSH_TEXT = "a blue object close to a yellow object"
"""The grounding model has no word for pucks; the dissertation's text of figure 4.5 has none either."""

_PUSH_PHRASES = tuple(f"a {colour} object" for colour in ("red", "green", "yellow", "blue"))
_PUSH_REWARD: Mapping[str, Any] = MappingProxyType(
    {
        "method": "criterion_captions",
        "phrases": list(_PUSH_PHRASES),
        "cameras": ["front"],
        "views": ["front", "", "front"],
        "object_widths": [_PUCK_WIDTH],
        "object_depth": _PUCK_DEPTH,
    }
)

_SMALL: Mapping[str, Any] = MappingProxyType({"encoder": "spatial", "action_repeat": 2})
"""Where there is no eye: for curiosity."""

_OURS: Mapping[str, Any] = MappingProxyType({"conditions": [NEAR], "carry_weight": 1.0})
"""As the teachers are trained."""

_PUSHING: Mapping[str, Any] = MappingProxyType(
    {"carry_weight": 1.0, "eye_model": _REWARD, "episode_steps": 0, "iterations": 89}
)
"""As the teachers, but from the task's own starts, in whole episodes; with images and explorations: 198 512 ticks."""

_DISSERTATIONS: Mapping[str, Any] = MappingProxyType(
    {
        "encoder": "spatial",
        "action_repeat": 1,
        "episode_steps": 0,
        "iterations": (_TICKS - _IMAGES * _IMAGE_STEPS) // (16 * 64),
    }
)
"""The dissertation's row: an encoder that is trained, a binary reward, no curriculum, no repeat, no shaping.

Its ticks and those of the images that the reward of pushing learns from are within the budget.
"""

_BALANCING: Mapping[str, Any] = MappingProxyType(
    {
        **_DISSERTATIONS,
        "height": 48,
        "width": 48,
        "gray": True,
        "frame_stack": 3,
        "num_steps": 128,
        "epochs": 5,
        "lr": 3e-4,
        "gamma": 0.99,
        "iterations": _TICKS // (16 * 128),
    }
)
"""A single frame tells no velocity."""


def shared_steps(arm: Arm) -> list[Step]:
    """Returns the steps that make what all trainings of a seed begin with: images of pucks, and a reward model of them.

    Its image encoder is the eye of all policies that have one.
    """
    if arm.world != PUSH:
        return []
    images = {"behaviour": "random", "count": _IMAGES, "cameras": ["front"], "seed": arm.seed}
    return [
        step(_IMAGES_OF_PUCKS, "collect", dataset=_IMAGES_OF_PUCKS, task="push.scatter", **images),
        step(
            _REWARD,
            "fit",
            service="reward",
            dataset=_IMAGES_OF_PUCKS,
            model_name=_REWARD,
            config={**_PUSH_REWARD, "seed": arm.seed},
        ),
    ]


def steps(arm: Arm) -> list[Step]:
    """Returns the pipeline of an arm, whose method is its reward; see `shared_steps`."""
    return [*_examples(arm), step(_PPO, "ppo", **_training(arm)), _evaluation(arm)]


def samples(trials: Trials) -> Iterator[tuple[str, Sample]]:
    """Yields returns by true states in points, those of random actions, and a share of the expert's if there is one."""
    episodes = trials[_RETURNS]
    own, chance = ([each[key] for each in episodes] for key in ("episode_return", "baseline_return"))
    yield POINTS, Sample(own, [1] * len(own))
    yield RANDOM, Sample(chance, [1] * len(chance))
    if "expert_return" in episodes[0]:
        yield RETURN, Sample(own, [each["expert_return"] for each in episodes])


def classifier_samples(data: Path, *, seed: int) -> Iterator[tuple[str, Sample]]:
    """Yields how a training's classifier of success, fitted as it was there, tells frames that it has not seen.

    Args:
        data: The training's data directory, with its datasets.
        seed: That of the training.
    """
    datasets = [Dataset(dataset_path(data, name)) for name in (_WON, _HELD_OUT)]
    camera = Camera(CAMERA, *datasets[0].spec.cameras[CAMERA])
    network = SuccessClassifier(camera.height, camera.width, camera.channels)
    seen, held_out = (examples(each, [camera]) for each in datasets)
    fit(network, *seen, torch.Generator().manual_seed(seed))
    with torch.no_grad():
        for name, frames, success in zip((TOLD_SUCCESS, TOLD_FAILURE), held_out, (True, False), strict=True):
            yield name, Sample(((network(frames) > 0) == success).float().tolist(), [1] * len(frames))


def _examples(arm: Arm) -> Iterator[Step]:
    """Yields what a reward learns from before the training."""
    if arm.method == VICE:
        for name, count, seed in (
            (_WON, _SUCCESSES, arm.seed),
            (_HELD_OUT, _HELD_OUT_SUCCESSES, _HELD_OUT_SEED),
        ):
            yield step(name, "collect", dataset=name, task=arm.world, count=count, seed=seed, settle=_SETTLE)


def _training(arm: Arm) -> dict[str, Any]:
    config: dict[str, Any] = {"task": arm.world, "reward": arm.method, "seed": arm.seed}
    if arm.method == VICE:
        config["dataset"] = _WON
    if arm.world == PUSH:
        config["goal_text"] = PUSH_TEXT
        if arm.method == LEARNED:
            config["reward_model"] = _REWARD
    return config | dict(_tuning(arm))


def _tuning(arm: Arm) -> Mapping[str, Any]:
    if arm.world == PENDULUM:
        return _BALANCING
    if arm.options[TUNING] == DISSERTATION:
        return _DISSERTATIONS
    if arm.world == PUSH:
        return _SMALL if arm.method == CURIOSITY else _PUSHING
    return {**_OURS, **_SMALL} if arm.method == CURIOSITY else _OURS


def _evaluation(arm: Arm) -> Step:
    policy: Sequence[Any] | Mapping[str, Any] = {"run": _PPO}
    return evaluate(_RETURNS, task=arm.world, policy=policy, baseline="random", episodes=_EPISODES)
