"""The rows of tables 3.3 and A.2 in `doom`, one configuration each, and random search of table 3.1.

All arms share their data and one goal recognizer, which a first pipeline makes once for all: it is fitted to the data
of curiosity, as in the dissertation. An arm fits its policy to the data of one exploration, and follows demonstrations
in the training map and in the one that chooses between configurations, A with textures V1.
"""

import json
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from experiments.robustness.evaluated import evaluate
from experiments.workbench import claims
from experiments.workbench.arms import Arm, Experiment, world_version
from experiments.workbench.cache_paths import cache_path
from experiments.workbench.claims import Claim
from experiments.workbench.configs import Config
from experiments.workbench.locks import locked
from experiments.workbench.pipelines import Step, link_folder, run_pipeline, step
from experiments.workbench.plots import interval_plot
from experiments.workbench.results import ArmResult, Outcome, Sample
from experiments.workbench.table import Picture, Section, Table, words
from freerein.learning.model_files import MODEL, read_card
from freerein.model_store import ModelStore
from freerein.types.common import ModelRef

RANDOM_SEARCH = "random_search"
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

GREEDY, SAMPLED = ACTING = "greedy", "sampled"
SETTINGS: Mapping[str, str] = {"a": "doom", "v1": "doom.v1"}
"""Tasks in which demonstrations are followed. Those of the tests, V2 and B, are not among them."""

_WORLD, _VERSION, _STEPS, _STEPS_OF_VARIANTS, _TRAJECTORIES, _EPISODES, _PER_CENT = (
    "doom",
    2,
    10_000,
    4_000,
    714,
    250,
    100,
)
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
_HEADER = (
    "row",
    "data",
    "seed",
    *(f"completion in {name.upper()}, {acting}, %" for name in SETTINGS for acting in ACTING),
    "minutes",
)


class Doom(Experiment):
    """An arm for each row, exploration and seed; random search has no fit."""

    @property
    def arms(self) -> tuple[Arm, ...]:
        """Random search, then all fits of a seed before those of the next."""
        rows = [(data, row, seeds) for data, rows in SEEDS.items() for row, seeds in rows.items()]
        most = max(seeds for _, _, seeds in rows)
        fits = (
            Arm(_WORLD, row, {"data": data}, seed) for seed in range(most) for data, row, seeds in rows if seed < seeds
        )
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
        """Fits a policy, and has it follow demonstrations by its likeliest actions, and by drawn ones."""
        is_fitted = arm.method != RANDOM_SEARCH
        if is_fitted:
            for part in ("datasets", "models"):
                link_folder(_shared_folder(work) / "data" / part, folder / "data" / part)
        trials = run_pipeline(steps(arm), folder, on_progress)
        found = {} if trials is None else {GREEDY: trials}
        if is_fitted and trials is not None:
            publish_sampled(folder / "data", folder / SAMPLED / "data")
            drawn = run_pipeline([*_evaluations({"model": _POLICY})], folder / SAMPLED, on_progress)
            found = {} if drawn is None else found | {SAMPLED: drawn}
        samples = {f"{acting}.{name}": _completions(each[name]) for acting, each in found.items() for name in SETTINGS}
        return Outcome({}, samples) if samples else None

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
    count = _STEPS_OF_VARIANTS if arm.method in _VARIANTS else _STEPS
    common = {"method": "goal_conditioned", "encoder": "convolutional", "steps": count, "seed": arm.seed}
    config = {**common, **named, **row}
    fit = step(_POLICY, "fit", service="imitation", dataset=arm.options["data"], model_name=_POLICY, config=config)
    return [fit, *_evaluations({"model": _POLICY})]


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


def _evaluations(policy: object) -> Iterator[Step]:
    for name, task in SETTINGS.items():
        shown = {"demonstration_conditions": ["heading-along-path"], "episodes": _EPISODES}
        yield evaluate("demonstrations", name, task=task, policy=policy, **shown)


def _shared_folder(work: Path) -> Path:
    made_by = {"steps": shared_steps(), "version": _VERSION, "world_version": world_version(_WORLD)}
    return cache_path(work / "doom", made_by, prefix="shared-")


def _completions(trials: Sequence[Mapping[str, Any]]) -> Sample:
    return Sample([each["completion"] for each in trials], [1] * len(trials))


def _cells(result: ArmResult) -> tuple[str, ...]:
    shown = (_cell(result.samples.get(f"{acting}.{name}")) for name in SETTINGS for acting in ACTING)
    return result.method, result.options.get("data", ""), str(result.seed), *shown, f"{result.minutes:.0f}"


def _cell(sample: Sample | None) -> str:
    if sample is None:
        return ""
    low, high = claims.interval([sample])
    return f"{_PER_CENT * sample.mean:.1f} [{_PER_CENT * low:.1f}, {_PER_CENT * high:.1f}]"


def _claims(results: Sequence[ArmResult]) -> Iterator[Claim]:
    """Yields the mean completion of each row by exploration, setting and way of acting; none has a target yet."""
    rows: dict[tuple[str, ...], list[ArmResult]] = {}
    for result in results:
        rows.setdefault((result.method, *result.options.values()), []).append(result)
    more: dict[str, Any] = {"unit": _PER_CENT, "command": "python -m experiments run doom"}
    for row, arms in rows.items():
        for name in arms[0].samples:
            samples = [arm.samples[name] for arm in arms]
            claim = "_".join(["doom", *row, *name.split(".")])
            yield claims.claim_of(claim, arms, samples, target=None, met=None, seeds=len(arms), **more)


EXPERIMENT = Doom()
