"""The rows of figure 3.3 in `rope`: demonstrations of knots and of the letter S, one action for each image.

Nothing is recurrent, for a picture shows all of the rope. Predictions are of pixels, as in the dissertation. Some
demonstrations choose, others are those of the tests.
"""

from collections.abc import Iterable, Mapping
from typing import Any

from experiments.chapter3.exploration import CHOICE, TEST, Exploration, Setting, recognizer_step
from experiments.chapter3.followed_report import Gain, Measured, Report
from experiments.chapter3.followers import Followers
from experiments.workbench.pipelines import step

_PIXELS = {"forward_consistency_weight": 0.1, "forward_target": "pixels"}
_ONE_STEP = {"recurrent": False, "use_previous_action": False}
_ROWS: Mapping[str, Mapping[str, Any]] = {
    "inverse_model": {"method": "inverse_model"},
    "gsp_regularised": {**_ONE_STEP, **_PIXELS, "forward_use": "regulariser"},
    "gsp": {**_ONE_STEP, **_PIXELS},
}
_TASK, _DATA = "rope", "random"
_TRAJECTORIES = 1_500
"""Of 40 actions, 60 000 in all; the last of each has no image after it."""

_STEPS = {"encoder": "convolutional", "steps": 6_500}
_ONE_ACTION = {"min_goal_steps": 1, "max_goal_steps": 1}
_START = ["start-from-left"]
_EPISODES = 10


def _shapes(path: str, seeds: Iterable[int], **more: Any) -> Setting:
    """Demonstrations of a shape, each followed from ten ropes that lie about as its own did, an action an image."""
    followed = {"task": _TASK, "paths": [path], "every": 1, "steps_per_landmark": 1, "length_factor": 2}
    started = {"demonstration_conditions": _START, "conditions": _START, "episodes": _EPISODES}
    evaluations = tuple({**followed, **started, "demonstration_seed": seed, **more} for seed in seeds)
    return Setting(evaluations, demonstrations=len(evaluations))


def _knots(seeds: Iterable[int]) -> Setting:
    """Knots; the registration finds wrong correspondences where strands cross, says the dissertation."""
    return _shapes("knot", seeds, measures=False)


EXPLORATION = Exploration(
    world=_TASK,
    version=1,
    shared=(
        step(_DATA, "collect", dataset=_DATA, task=_TASK, behaviour="random", count=_TRAJECTORIES),
        recognizer_step(_DATA, **_STEPS, close_steps=1, far_steps=5),
    ),
    fit={**_STEPS, **_ONE_ACTION, "head": "autoregressive"},
    rows=_ROWS,
    seeds={_DATA: {"gsp": 3, "gsp_regularised": 2, "inverse_model": 2}},
    claimed=("gsp", _DATA),
    settings={
        CHOICE: {"knot_choice": _knots(range(100, 105)), "s_choice": _shapes("s-shape", range(100, 103))},
        TEST: {"knot": _knots(range(20)), "s": _shapes("s-shape", range(10))},
    },
    chooses=("knot_choice", "success"),
    figures=("success", "tps-rpm", "completion"),
    switching="steps",
)

_KNOTS = Measured("knot", "success", least=45.0, ceiling=90.0, dissertation=60.0)
_S = Measured("s", "tps-rpm", unit=1000)

EXPERIMENT = Followers(
    EXPLORATION,
    Report(
        title="Knots and the letter S (Figure 3.3)",
        measured=(_KNOTS, _S),
        gains=(
            Gain("rope_gsp_over_inverse_model", "inverse_model", _DATA, _KNOTS, seeds=2),
            Gain("rope_gsp_over_regularised", "gsp_regularised", _DATA, _KNOTS, seeds=2),
            Gain("rope_s_gsp", "inverse_model", _DATA, _S, seeds=2, is_less=True),
        ),
        flags="knot",
        unit="knots, per cent; cost, mm",
    ),
)
"""Chapter 3: a rope, moved as images of a demonstration show."""
