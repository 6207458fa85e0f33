"""The rows of tables 3.3 and A.2 in `doom`, one configuration each, and random search of table 3.1.

All arms share their data and one goal recognizer, which a first pipeline makes once for all: it is fitted to the data
of curiosity, as in the dissertation. An arm fits its policy to the data of one exploration, and follows demonstrations
in the training map and in the one that chooses between configurations, A with textures V1.
"""

import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

from experiments.robustness.evaluated import evaluate
from experiments.workbench import claims
from experiments.workbench.arms import Arm, Experiment, world_version
from experiments.workbench.cache_paths import cache_path
from experiments.workbench.claims import Claim
from experiments.workbench.configs import Config
from experiments.workbench.locks import locked
from experiments.workbench.pipelines import Step, fit_step, run_pipeline, step
from experiments.workbench.plots import interval_plot
from experiments.workbench.results import ArmResult, Outcome, Sample
from experiments.workbench.table import Picture, Section, Table, words

RANDOM_SEARCH = "random_search"
_CONSISTENT = {"forward_consistency_weight": 0.1}
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

ACTING: Mapping[str, Mapping[str, Any]] = {"greedy": {}, "sampled": {"temperature": 1.0}}
SETTINGS: Mapping[str, str] = {"a": "doom", "v1": "doom.v1"}
"""Tasks in which demonstrations are followed. Those of the tests, V2 and B, are not among them."""

_WORLD, _VERSION, _STEPS, _TRAJECTORIES, _EPISODES, _PER_CENT = "doom", 1, 10_000, 714, 250, 100
_RECOGNIZER = "recognizer"
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
_HEADER = ("row", "data", "acts", "seed", *(f"completion in {name.upper()}, %" for name in SETTINGS), "minutes")


class Doom(Experiment):
    """An arm for each row, exploration and way of acting, each with one seed; random search has no fit."""

    @property
    def arms(self) -> tuple[Arm, ...]:
        """The arms, row after row."""
        options = product(ROWS, _DATA, ACTING)
        fits = (Arm(_WORLD, row, {"data": data, "acting": acting}) for row, data, acting in options)
        return (Arm(_WORLD, RANDOM_SEARCH), *fits)

    def config(self, arm: Arm) -> Config:
        """Returns the steps of the pipeline that arms share, and of the arm's own."""
        return {"version": _VERSION, "shared": shared_steps(), "steps": steps(arm)}

    def prepare(self, arm: Arm, work: Path) -> bool:
        """Makes data and recognizer, or waits until another arm has made them."""
        if arm.method == RANDOM_SEARCH:
            return True
        with locked(work / "doom" / "shared.lock"):
            made = run_pipeline(shared_steps(), _shared_folder(work), lambda: None, keeps_datasets=True)
        return made is not None

    def run(
        self, arm: Arm, *, results: Path, work: Path, folder: Path, on_progress: Callable[[], None]
    ) -> Outcome | None:
        """Fits a policy, and has it follow demonstrations; see `Experiment`."""
        if arm.method != RANDOM_SEARCH:
            for part in ("datasets", "models"):
                _link(_shared_folder(work) / "data" / part, folder / "data" / part)
        trials = run_pipeline(steps(arm), folder, on_progress)
        return None if trials is None else Outcome({}, {name: _completions(trials[name]) for name in SETTINGS})

    def table(self, results: Sequence[ArmResult]) -> Table:
        """Returns a row for each arm that has a result, and the claims."""
        made = tuple(_claims(results))
        draw = partial(interval_plot, list(made), title="Demonstrations followed", unit="mean completion, per cent")
        return Table(
            title="Following demonstrations in rooms and corridors (Tables 3.3 and A.2)",
            text=words("doom"),
            sections=(Section(_HEADER, tuple(map(_cells, results))),),
            claims=made,
            picture=Picture("Completion of demonstrations by row", draw),
        )


def shared_steps() -> list[Step]:
    """Returns the steps that make data and recognizer."""
    collect = {"task": _WORLD, "behaviour": "mix", "count": _TRAJECTORIES}
    recognizer = {"method": "goal_recognizer", "encoder": "convolutional", "steps": _STEPS}
    return [
        step("curious", "ppo", task=_WORLD, **_CURIOSITY),
        *(step(name, "collect", dataset=name, parts=list(parts), **collect) for name, parts in _DATA.items()),
        step(_RECOGNIZER, "fit", service="imitation", dataset="curiosity", model_name=_RECOGNIZER, config=recognizer),
    ]


def steps(arm: Arm) -> list[Step]:
    """Returns the steps of an arm's pipeline."""
    if arm.method == RANDOM_SEARCH:
        return [*_evaluations("random")]
    row = ROWS[arm.method]
    named = {} if row.get("stop") else {"recognizer": _RECOGNIZER}
    common = {"method": "goal_conditioned", "encoder": "convolutional", "steps": _STEPS, "seed": arm.seed}
    config = {**common, **named, **ACTING[arm.options["acting"]], **row}
    return [fit_step("policy", "imitation", arm.options["data"], **config), *_evaluations({"run": "policy"})]


def _evaluations(policy: object) -> Iterator[Step]:
    for name, task in SETTINGS.items():
        shown = {"demonstration_conditions": ["heading-along-path"], "episodes": _EPISODES}
        yield evaluate("demonstrations", name, task=task, policy=policy, **shown)


def _shared_folder(work: Path) -> Path:
    made_by = {"steps": shared_steps(), "version": _VERSION, "world_version": world_version(_WORLD)}
    return cache_path(work / "doom", made_by, prefix="shared-")


def _link(source: Path, target: Path) -> None:
    """Copies a folder as hard links, unless it is there; a copy that was cut short is made again."""
    if not target.exists():
        part = target.with_name(f".{target.name}.part")
        shutil.rmtree(part, ignore_errors=True)
        shutil.copytree(source, part, copy_function=os.link)
        part.rename(target)


def _completions(trials: Sequence[Mapping[str, Any]]) -> Sample:
    return Sample([each["completion"] for each in trials], [1] * len(trials))


def _cells(result: ArmResult) -> tuple[str, ...]:
    shown = []
    for name in SETTINGS:
        sample = result.samples[name]
        low, high = claims.interval([sample])
        shown.append(f"{_PER_CENT * sample.mean:.1f} [{_PER_CENT * low:.1f}, {_PER_CENT * high:.1f}]")
    options = [result.options.get(name, "") for name in ("data", "acting")]
    return result.method, *options, str(result.seed), *shown, f"{result.minutes:.0f}"


def _claims(results: Sequence[ArmResult]) -> Iterator[Claim]:
    """Yields the mean completion of each arm in each setting; none has a target yet."""
    more: dict[str, Any] = {"unit": _PER_CENT, "seeds": 1, "command": "python -m experiments run doom"}
    for arm in results:
        for name in SETTINGS:
            claim = "_".join([arm.method, *arm.options.values(), name])
            yield claims.claim_of(f"doom_{claim}", [arm], [arm.samples[name]], target=None, met=None, **more)


EXPERIMENT = Doom()
