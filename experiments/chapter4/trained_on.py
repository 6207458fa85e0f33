"""Policies that PPO trains on one of several rewards, in the tasks of figure 4.6 and in the pendulum of figure 4.4."""

from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from experiments.robustness.evaluated import evaluate
from experiments.robustness.worlds import NEAR
from experiments.workbench.arms import Arm
from experiments.workbench.pipelines import Step, Trials, fit_step, step
from experiments.workbench.results import Sample

LEARNED, ORACLE, BASE, RULE, VICE = "learned", "oracle", "base", "rule", "vice"
CURIOSITY, CONSTANT, ALIVE = "curiosity", "constant", "alive"
PUSH, STACK, PLACE = "push", "blocks.yellow-on-top-of-red", "blocks.yellow-right-of-red"
PENDULUM = "pendulum"

OURS, DISSERTATION = "ours", "dissertation"
TUNING = "tuning"
RETURN, POINTS = "return", "points"

_PPO, _RETURNS = "ppo", "returns"
_EPISODES, _IMAGES, _SUCCESSES = 100, 1000, 100
_SETTLE = 2
_TICKS = 200_000
_PUCK_WIDTH = 0.095
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
    }
)

_SMALL: Mapping[str, Any] = MappingProxyType({"encoder": "spatial", "action_repeat": 2})
"""Where there is no eye: for pucks, and for curiosity."""

_OURS: Mapping[str, Any] = MappingProxyType({"conditions": [NEAR], "carry_weight": 1.0})
"""As the teachers are trained."""

_DISSERTATIONS: Mapping[str, Any] = MappingProxyType(
    {"encoder": "spatial", "action_repeat": 1, "episode_steps": 0, "iterations": _TICKS // (16 * 64)}
)
"""The dissertation's row: an encoder that is trained, a binary reward, no curriculum, no repeat, no shaping."""

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


def steps(arm: Arm) -> list[Step]:
    """Returns the pipeline of an arm, whose method is its reward."""
    return [*_examples(arm), step(_PPO, "ppo", **_training(arm)), _evaluation(arm)]


def samples(trials: Trials) -> Iterator[tuple[str, Sample]]:
    """Yields returns by true states in points, and as a share of the expert's where there is one."""
    episodes = trials[_RETURNS]
    own = [each["episode_return"] for each in episodes]
    yield POINTS, Sample(own, [1] * len(own))
    if "expert_return" in episodes[0]:
        yield RETURN, Sample(own, [each["expert_return"] for each in episodes])


def _examples(arm: Arm) -> Iterator[Step]:
    """Yields what a reward learns from before the training."""
    if arm.method == VICE:
        yield step("won", "collect", dataset="won", task=arm.world, count=_SUCCESSES, seed=arm.seed, settle=_SETTLE)
    if arm.world == PUSH and arm.method == LEARNED:
        images = {"behaviour": "random", "count": _IMAGES, "cameras": ["front"], "seed": arm.seed}
        yield step("images", "collect", dataset="images", task="push.scatter", **images)
        yield fit_step("reward", "reward", "images", **_PUSH_REWARD, seed=arm.seed)


def _training(arm: Arm) -> dict[str, Any]:
    config: dict[str, Any] = {"task": arm.world, "reward": arm.method, "seed": arm.seed}
    if arm.method == VICE:
        config["dataset"] = "won"
    if arm.world == PUSH:
        config["goal_text"] = PUSH_TEXT
    return config | dict(_tuning(arm))


def _tuning(arm: Arm) -> Mapping[str, Any]:
    if arm.world == PENDULUM:
        return _BALANCING
    if arm.options[TUNING] == DISSERTATION:
        return _DISSERTATIONS
    sees_by_eye = arm.world != PUSH and arm.method != CURIOSITY
    starts = _OURS if arm.world != PUSH else {}
    return starts if sees_by_eye else {**starts, **_SMALL}


def _evaluation(arm: Arm) -> Step:
    policy: Sequence[Any] | Mapping[str, Any] = {"run": _PPO}
    return evaluate(_RETURNS, task=arm.world, policy=policy, baseline="random", episodes=_EPISODES)
