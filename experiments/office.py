"""The rows of tables 3.1, 3.2 and A.1 in `office`: single goals, and demonstrations of a maze and a loop.

Data are of two floors; a third chooses, the fourth is that of the tests. Predictions are of pixels, as in the
dissertation. Nothing is trained before, which a row of `doom` measures: so all rows have equal updates of the policy.
"""

from collections.abc import Mapping
from itertools import combinations
from typing import Any

from experiments.chapter3.exploration import CHOICE, FOLLOWED, RECOGNIZER, TEST, Choice, Exploration, Setting
from experiments.chapter3.followed_report import Gain, Measured, Report
from experiments.chapter3.followers import Followers
from experiments.workbench.pipelines import step

_ROWS: Mapping[str, Mapping[str, Any]] = {
    "inverse_model": {"method": "inverse_model", "batch_size": 58},
    "gsp_no_previous_action": {"use_previous_action": False},
    "gsp_no_consistency": {},
    "gsp": {"forward_consistency_weight": 0.1, "forward_target": "pixels"},
}
"""Slices of one action are of windows of 10 frames, others of 24: as many frames in each update."""

_TASK, _DATA = "office", "random"
_COLLECTED = {"count": 4_400, "height": 48, "width": 48}
"""Trajectories end where the robot touches something, after 57 actions in the mean of 500: 240 000 in all."""

_FIT = {"encoder": "convolutional", "steps": 4_400, "evaluate_every": 250}
"""Ten passes: an update sees 24 windows of 24 frames."""
_LR = {RECOGNIZER: 6e-3, "inverse_model": 2e-2, "gsp_no_consistency": 6e-3}
"""The rate of the lowest held-out loss of each among the arms `pilot`."""

_RATES = (6e-4, 2e-3, 6e-3, 2e-2)

_FLOORS = ({"policy": "random", "task": "office"}, {"policy": "random", "task": "office.2"})
_GOALS = [f"goal-{number}" for number in range(1, 11)]
_PATHS = ("maze", "loop")
_TRIALS = {"episodes": 100, "num_envs": 50}
_LIMIT = {"length_factor": 100, "most_steps": 200}


def _goals(floor: str) -> Setting:
    """Single goals: the last image of a demonstration, for 200 actions, until the policy says it is there."""
    followed = {"task": floor, "paths": _GOALS, "every": 1000, "steps_per_landmark": 10_000, **_LIMIT}
    chosen = Choice("goals_3", "stopped.goal")
    return Setting(({**followed, **_TRIALS},), demonstrations=len(_GOALS), choice=chosen)


def _path(floor: str, path: str, **more: Any) -> Setting:
    followed = {"task": floor, "paths": [path], "every": 5, "demonstration_conditions": ["heading-along-path"]}
    chosen = Choice(f"{path}_3", "completion")
    return Setting(({**followed, **_TRIALS, **more},), demonstrations=1, choice=chosen)


def _sift(floor: str, suffix: str = "") -> dict[str, Setting]:
    """Maze and loop by every fifth image, and by every frame."""
    return {
        **{f"{path}{suffix}": _path(floor, path) for path in _PATHS},
        **{f"{path}_every_frame{suffix}": _path(floor, path, every=1) for path in _PATHS},
    }


EXPLORATION = Exploration(
    world=_TASK,
    version=3,
    collects=(step(_DATA, "collect", dataset=_DATA, task=_TASK, behaviour="mix", parts=list(_FLOORS), **_COLLECTED),),
    timesteps=230_000,
    recognizer=_FIT,
    fit=_FIT,
    rows=_ROWS,
    lr=_LR,
    rates={**dict.fromkeys(_LR, _RATES), "inverse_model": (*_RATES, 6e-2)},
    seeds={_DATA: {"gsp": 3, "gsp_no_consistency": 2, "gsp_no_previous_action": 2, "inverse_model": 2}},
    claimed=("gsp", _DATA),
    settings={
        CHOICE: {
            "goals_3": _goals("office.3"),
            "maze_3": _path("office.3", "maze"),
            "loop_3": _path("office.3", "loop"),
        },
        TEST: {
            "goals": _goals("office.4"),
            "maze": _path("office.4", "maze"),
            "loop": _path("office.4", "loop"),
            "maze_light": _path("office.4", "maze", conditions=["light-0.6"]),
            "loop_light": _path("office.4", "loop", conditions=["light-0.6"]),
        },
    },
    sift={CHOICE: _sift("office.3", "_3"), TEST: _sift("office.4")},
    places=2,
    figures=("stopped.goal", "success", "contact", "completion", "efficiency", "recognized", "ended", *FOLLOWED),
)

_ORDER = ("gsp", "gsp_no_consistency", "gsp_no_previous_action", "inverse_model")
"""Of the dissertation, the best first."""


def _landmarks(path: str, *, least: float, dissertation: float) -> Measured:
    claim = f"office_landmarks_{path}"
    return Measured(path, "completion", claim=claim, least=least, ceiling=95.0, dissertation=dissertation)


_STOPPED = Measured("goals", "stopped.goal", claim="office_gsp", least=60.0, dissertation=75.0)

EXPERIMENT = Followers(
    EXPLORATION,
    Report(
        title="Single goals, a maze and a loop on an unseen floor (Tables 3.1, 3.2 and A.1)",
        measured=(
            _STOPPED,
            Measured("goals", "success", ceiling=95.0),
            _landmarks("maze", least=70.0, dissertation=87.0),
            _landmarks("loop", least=50.0, dissertation=67.0),
            Measured("maze_light", "completion"),
            Measured("loop_light", "completion"),
        ),
        gains=tuple(
            Gain(f"office_{row}_over_{other}", other, _DATA, _STOPPED, seeds=2, of=(row, _DATA))
            for row, other in combinations(_ORDER, 2)
        ),
        flags="maze",
    ),
)
"""Chapter 3: goals and demonstrations given as images, followed on a floor that no data are of."""
