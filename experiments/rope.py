"""The rows of figure 3.3 in `rope`: demonstrations of knots and of the letter S, one action for each image.

Nothing is recurrent, for a picture shows all of the rope. Predictions are of pixels, as in the dissertation. Some
demonstrations choose, others are those of the tests.
"""

from collections.abc import Iterable, Mapping
from typing import Any

from experiments import doom, office
from experiments.chapter3.exploration import CHOICE, FOLLOWED, RECOGNIZER, TEST, Choice, Exploration, Setting
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
_TRAJECTORIES = 1_540
"""Of 40 actions, the last of which has no image after it: 60 060 in all."""

_STEPS = {"encoder": "convolutional", "steps": 6_500, "evaluate_every": 250}
_LR = {RECOGNIZER: 2e-3, "inverse_model": 2e-3, "gsp": 2e-3}
"""To be set from the arms `pilot`, the rate of the lowest held-out loss of each, before anything else is trained."""

_RATES = (6e-4, 2e-3, 6e-3, 2e-2)

_ONE_ACTION = {"min_goal_steps": 1, "max_goal_steps": 1}
_START = ["start-from-left"]
_EPISODES = 10
_KNOT = Choice("knot_choice", "success")
_S_SHAPE = Choice("s_choice", "tps-rpm", is_less=True)


def _shapes(path: str, seeds: Iterable[int], choice: Choice, starts: int, **more: Any) -> Setting:
    """Demonstrations of a shape, each followed from ten ropes that lie about as its own did, an action an image.

    Args:
        path: The shape.
        seeds: Of the demonstrations.
        choice: What chooses the way of acting.
        starts: Seed of the ropes, to which a thousand times that of the demonstration is added.
        more: Further configuration of the evaluations.
    """
    followed = {"task": _TASK, "paths": [path], "every": 1, "steps_per_landmark": 1, "length_factor": 2}
    started = {"demonstration_conditions": _START, "conditions": _START, "episodes": _EPISODES}
    evaluations = tuple(
        {**followed, **started, "demonstration_seed": seed, "seed": starts + 1000 * seed, **more} for seed in seeds
    )
    return Setting(evaluations, demonstrations=len(evaluations), choice=choice)


def _knots(seeds: Iterable[int], starts: int) -> Setting:
    """Knots; the registration finds wrong correspondences where strands cross, says the dissertation."""
    return _shapes("knot", seeds, _KNOT, starts, measures=False)


EXPLORATION = Exploration(
    world=_TASK,
    version=3,
    collects=(step(_DATA, "collect", dataset=_DATA, task=_TASK, behaviour="random", count=_TRAJECTORIES),),
    timesteps=60_000,
    recognizer={**_STEPS, "close_steps": 1, "far_steps": 5},
    fit={**_STEPS, **_ONE_ACTION, "head": "autoregressive"},
    rows=_ROWS,
    lr=_LR,
    rates=dict.fromkeys(_LR, _RATES),
    seeds={_DATA: {"gsp": 3, "gsp_regularised": 2, "inverse_model": 2}},
    claimed=("gsp", _DATA),
    settings={
        CHOICE: {
            "knot_choice": _knots(range(100, 105), 3_000_003),
            "s_choice": _shapes("s-shape", range(100, 103), _S_SHAPE, 4_000_003),
        },
        TEST: {"knot": _knots(range(20), 1_000_003), "s": _shapes("s-shape", range(10), _S_SHAPE, 2_000_003)},
    },
    figures=("success", "tps-rpm", "completion", "recognized", "ended", *FOLLOWED),
    switching="steps",
    truth={"steps_per_landmark": 4, "length_factor": 5},
    counts_knots=True,
)

_KNOTS = Measured("knot", "success", claim="rope_gsp", least=45.0, ceiling=90.0, dissertation=60.0)
_S = Measured("s", "tps-rpm", unit=1000)

EXPERIMENT = Followers(
    EXPLORATION,
    Report(
        title="Knots and the letter S (Figure 3.3)",
        measured=(_KNOTS, _S),
        gains=(
            Gain("rope_gsp_over_inverse_model", "inverse_model", _DATA, _KNOTS, seeds=2),
            Gain("rope_gsp_over_regularised", "gsp_regularised", _DATA, _KNOTS, seeds=2),
            Gain(
                "rope_regularised_over_inverse_model",
                "inverse_model",
                _DATA,
                _KNOTS,
                seeds=2,
                of=("gsp_regularised", _DATA),
            ),
            Gain("rope_s_gsp", "inverse_model", _DATA, _S, seeds=2, is_less=True),
        ),
        flags="knot",
        unit="knots, per cent; cost, mm",
    ),
    others=(doom.EXPERIMENT, office.EXPERIMENT),
)
"""Chapter 3: a rope, moved as images of a demonstration show."""
