"""The rows of tables 3.3 and A.2 in `doom`, one configuration each, and random search of table 3.1.

All arms share their data and one goal recognizer, which a first pipeline makes once for all: it is fitted to the data
of curiosity, as in the dissertation. A policy is fitted to the data of one exploration, once for two arms: one follows
demonstrations in the training map and in the one that chooses between greedy and sampled actions, A with textures V1;
the other in those of the tests.
"""

import json
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from experiments.chapter3 import followed_report
from experiments.chapter3.followed import (
    ACTING,
    CEILINGS,
    CHOICE,
    EXPERT,
    GREEDY,
    RANDOM_SEARCH,
    SETTINGS,
    TEST,
    TRUE_SWITCHING,
    samples,
)
from experiments.robustness.evaluated import evaluate
from experiments.workbench.arms import Arm, Experiment, world_version
from experiments.workbench.configs import Config
from experiments.workbench.pipelines import Step, Trials, run_once, run_pipeline, step
from experiments.workbench.results import ArmResult, Outcome
from experiments.workbench.table import Table
from freerein.learning.model_files import MODEL, read_card
from freerein.model_store import ModelStore
from freerein.types.common import ModelRef

_CONSISTENT = {"forward_consistency_weight": 0.1}
_VARIANTS = ("gsp_pixels", "gsp_one_step", "gsp_stop", "gsp_pretrained")
"""Rows that are fitted for fewer steps."""

_SIDE_ROWS = ("inverse_model", "gsp_no_previous_action", "gsp_regularised", *_VARIANTS)
ROWS: Mapping[str, Mapping[str, Any]] = {
    "inverse_model": {"method": "inverse_model"},
    "gsp_no_previous_action": {"use_previous_action": False},
    "gsp_no_consistency": {},
    "gsp_regularised": {**_CONSISTENT, "forward_use": "regulariser"},
    "gsp_pixels": {**_CONSISTENT, "forward_target": "pixels"},
    "gsp_features": _CONSISTENT,
    "gsp_one_step": {
        **_CONSISTENT,
        "min_goal_steps": 1,
        "max_goal_steps": 1,
        "recurrent": False,
        "use_previous_action": False,
    },
    "gsp_stop": {**_CONSISTENT, "stop": True},
    "gsp_pretrained": {**_CONSISTENT, "forward_pretraining_steps": 1000, "policy_pretraining_steps": 1000},
}
"""What each row's fit has beside what all have."""

SEEDS: Mapping[str, Mapping[str, int]] = {
    "curiosity": {"gsp_features": 4, "gsp_no_consistency": 4, **dict.fromkeys(_SIDE_ROWS, 1)},
    "random": {"gsp_features": 3, "inverse_model": 1},
}
"""Number of fits of each row to the data of each exploration; those of 4 are paired, for what consistency brings."""

_WORLD, _VERSION, _STEPS, _STEPS_OF_VARIANTS, _TRAJECTORIES, _EPISODES = "doom", 3, 10_000, 4_000, 714, 250
_DATA_OPTION, _SETTINGS_OPTION = "data", "settings"
_RECOGNIZER, _POLICY = "recognizer", "policy"
_FIXED_ROOM = {"conditions": ["start-room-10"]}
_DATA: Mapping[str, Sequence[Mapping[str, Any]]] = {
    "curiosity": (
        {"policy": "curious", "share": 40},
        {"policy": "curious", "share": 25, "stochastic": True},
        {"policy": "curious", "share": 25, "stochastic": True, **_FIXED_ROOM},
    ),
    "random": ({"policy": "random", "share": 2}, {"policy": "random", "share": 1, **_FIXED_ROOM}),
}
"""Parts of the data of each exploration, a dataset of its name."""

_CURIOSITY = {
    "reward": "curiosity",
    "encoder": "convolutional",
    "recurrent": True,
    "action_repeat": 1,
    "episode_steps": 0,
    "gamma": 0.99,
    "ent_coef": 0.01,
}


class Doom(Experiment):
    """An arm for each row, exploration, seed and kind of settings; random search, expert and ceiling have no fit."""

    @property
    def arms(self) -> tuple[Arm, ...]:
        """What needs no fit, then all fits of a seed before those of the next; the settings of the tests are last."""
        rows = [(data, row, seeds) for data, rows in SEEDS.items() for row, seeds in rows.items()]
        fits = [
            (row, data, seed)
            for seed in range(max(seeds for _, _, seeds in rows))
            for data, row, seeds in rows
            if seed < seeds
        ]
        return tuple(
            Arm(_WORLD, row, {**({_DATA_OPTION: data} if data else {}), _SETTINGS_OPTION: settings}, seed)
            for settings in (CHOICE, TEST)
            for row, data, seed in [(EXPERT, "", 0), (RANDOM_SEARCH, "", 0), (TRUE_SWITCHING, "curiosity", 0), *fits]
        )

    def config(self, arm: Arm) -> Config:
        """Returns the steps of the pipeline that arms share, of the fit, and of the arm's own."""
        fit = [fit_step(arm)] if is_fitted(arm) else []
        return {"version": _VERSION, "shared": shared_steps(), "fit": fit, "steps": list(steps(arm))}

    def prepare(self, arm: Arm, work: Path) -> bool:
        """Makes data and recognizer, or waits until another arm has made them."""
        return not is_fitted(arm) or _shared(work) is not None

    def run(
        self, arm: Arm, *, results: Path, work: Path, folder: Path, on_progress: Callable[[], None]
    ) -> Outcome | None:
        """Has a policy follow demonstrations by its likeliest actions, and by drawn ones; see `Experiment`."""
        found: dict[str, Trials] = {}
        fitted = _fitted(arm, work, on_progress) if is_fitted(arm) else None
        if is_fitted(arm) and fitted is None:
            return None
        for acting in ACTING if fitted and arm.method not in CEILINGS else ACTING[:1]:
            source = fitted
            if fitted and acting != GREEDY:
                source = folder / "drawn"
                publish_sampled(fitted / "data", source / "data")
            trials = run_pipeline([*steps(arm)], folder / acting, on_progress, source=source)
            if trials is None:
                return None
            found[acting] = trials
        return Outcome({}, dict(samples(found)))

    def table(self, results: Sequence[ArmResult]) -> Table:
        """Returns a row for each fit that has results, and the claims."""
        return followed_report.table(results)


def is_fitted(arm: Arm) -> bool:
    """Returns whether an arm has a policy that is fitted."""
    return arm.method not in (EXPERT, RANDOM_SEARCH)


def shared_steps() -> list[Step]:
    """Returns the steps that make data and recognizer."""
    collect = {"task": _WORLD, "behaviour": "mix", "count": _TRAJECTORIES}
    recognizer = {"method": "goal_recognizer", "encoder": "convolutional", "steps": _STEPS}
    return [
        step("curious", "ppo", task=_WORLD, **_CURIOSITY),
        *(step(name, "collect", dataset=name, parts=list(parts), **collect) for name, parts in _DATA.items()),
        step(_RECOGNIZER, "fit", service="imitation", dataset="curiosity", model_name=_RECOGNIZER, config=recognizer),
    ]


def fit_step(arm: Arm) -> Step:
    """Returns the step that fits the policy of an arm; that of true switching is the one that claims rest on."""
    name = "gsp_features" if arm.method == TRUE_SWITCHING else arm.method
    row = ROWS[name]
    named = {} if row.get("stop") else {"recognizer": _RECOGNIZER}
    count = _STEPS_OF_VARIANTS if name in _VARIANTS else _STEPS
    common = {"method": "goal_conditioned", "encoder": "convolutional", "steps": count, "seed": arm.seed}
    config = {**common, **named, **row}
    return step(
        _POLICY, "fit", service="imitation", dataset=arm.options[_DATA_OPTION], model_name=_POLICY, config=config
    )


def steps(arm: Arm) -> Iterator[Step]:
    """Yields the steps that evaluate an arm, one for each of its settings."""
    policy = {EXPERT: "expert", RANDOM_SEARCH: "random"}.get(arm.method, {"model": _POLICY})
    switching = {"switching": "truth"} if arm.method == TRUE_SWITCHING else {}
    for name, task in SETTINGS[arm.options[_SETTINGS_OPTION]].items():
        shown = {"demonstration_conditions": ["heading-along-path"], "episodes": _EPISODES}
        yield evaluate("demonstrations", name, task=task, policy=policy, **shown, **switching)


def _fitted(arm: Arm, work: Path, on_progress: Callable[[], None]) -> Path | None:
    """Fits the policy of an arm, once for all arms that act by it, to data that are made once for all."""
    shared = _shared(work)
    if shared is None:
        return None
    made_by = {**_made_by(), "shared": shared_steps()}
    return run_once([fit_step(arm)], made_by, work / "doom", on_progress, source=shared)


def _shared(work: Path) -> Path | None:
    return run_once(shared_steps(), _made_by(), work / "doom", lambda: None)


def _made_by() -> dict[str, Any]:
    return {"version": _VERSION, "world_version": world_version(_WORLD)}


def publish_sampled(fitted: Path, data_dir: Path) -> None:
    """Publishes the policy of one data directory in another, with a card that says that its actions are drawn."""
    made = ModelStore(fitted / "models" / "imitation")
    source = made.folder(ModelRef(_POLICY, made.active_version(_POLICY)))
    with TemporaryDirectory(dir=fitted) as staging:
        copy, card = Path(staging) / _POLICY, read_card(source)
        copy.mkdir()
        shutil.copyfile(source / MODEL.weights, copy / MODEL.weights)
        (copy / MODEL.card).write_text(json.dumps({**card, "spec": {**card["spec"], "temperature": 1.0}}))
        store = ModelStore(data_dir / "models" / "imitation")
        store.activate(store.publish(_POLICY, copy))


EXPERIMENT = Doom()
