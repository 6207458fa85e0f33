"""Table 4.1's nine criteria, learned from captions of scattered pucks, blocks and a tray, on held-out images."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from experiments.chapter4.puck_scenes import CAMERAS, PHRASES, Asked, PuckScenes, asked
from experiments.robustness.confidence import by_trial
from experiments.robustness.draw import Drawn, dataset_path, open_or_draw
from experiments.robustness.fits import fit_once
from experiments.robustness.reward_model import grounding_version, open_grounding
from experiments.workbench import claims
from experiments.workbench.arms import Arm, Experiment
from experiments.workbench.claims import Claim
from experiments.workbench.configs import Config
from experiments.workbench.plots import interval_plot
from experiments.workbench.results import ArmResult, Outcome, Sample
from experiments.workbench.table import Picture, Section, Table, words
from freerein.criteria import CRITERIA, View, criteria
from freerein.criterion_text import Claim as Said
from freerein.criterion_text import CriterionCaption
from freerein_reward.methods.criterion_captions.config import CriterionConfig
from freerein_reward.methods.criterion_captions.criterion_model import CriterionModel
from freerein_reward.methods.criterion_captions.keypoint_dataset import KeypointDataset, find_keypoints, view_layout
from freerein_reward.methods.criterion_captions.losses import CriterionLearner
from freerein_reward.methods.criterion_captions.method import METHOD, network_spec

MODEL, RULE = "criterion_captions", "rule"
_TRAINING, _TEST = PuckScenes(count=1500, seed=2), PuckScenes(count=300, seed=1_000_002)
_SEEDS, _VERSION, _PER_CENT = 3, 2, 100
_VIEWS = ("front", "left", "front")
_WIDTH, _CONTAINER, _ASPECT, _SHOWN = 0.117, 2.4, 1.0, 0.5
_LEAST = 85.0

Flags = npt.NDArray[np.bool_]


class NineCriteria(Experiment):
    """An arm for each fit, and one for the captions' rule without a fit."""

    @property
    def arms(self) -> tuple[Arm, ...]:
        """The rule, then the fits."""
        fits = (Arm(PuckScenes.task, MODEL, seed=seed) for seed in range(_SEEDS))
        return Arm(PuckScenes.task, RULE), *fits

    def config(self, arm: Arm) -> Config:
        """Returns the scenes, the grounding model and the configuration of a fit."""
        config: dict[str, object] = {"version": _VERSION, "test": _TEST, "grounding": grounding_version()}
        return config if arm.method == RULE else config | {"training": _TRAINING, "fit": _fit_config(arm.seed)}

    def prepare(self, arm: Arm, work: Path) -> bool:
        """Draws the scenes."""
        for spec in (_TEST, _TRAINING):
            open_or_draw(spec, work)
        return True

    def run(
        self, arm: Arm, *, results: Path, work: Path, folder: Path, on_progress: Callable[[], None]
    ) -> Outcome | None:
        """Fits, and judges held-out scenes; see `Experiment`. Checkpoints are in `work`."""
        torch.set_num_threads(1)
        drawn = open_or_draw(_TEST, work)
        if arm.method == RULE:
            return Outcome({}, dict(_samples(drawn, _judge_by_rule(drawn))))
        model = _fit_model(_fit_config(arm.seed), work, on_progress)
        return None if model is None else Outcome({}, dict(_samples(drawn, _judge(model, drawn))))

    def table(self, results: Sequence[ArmResult]) -> Table:
        """Returns the balanced accuracy of each criterion, of the fits and of the rule."""
        by_method = {each: [result for result in results if result.method == each] for each in (RULE, MODEL)}
        made = [claim for method, arms in by_method.items() if arms for claim in _claims(method, arms)]
        rows = tuple((name, *(_cell(arms, name) for arms in by_method.values())) for name in CRITERIA)
        if len(by_method[MODEL]) == _SEEDS:
            worst = min((each for each in made if each.target is not None), key=lambda claim: claim.value)
            made.append(Claim(**{**vars(worst), "claim": "criteria"}))
        draw = partial(interval_plot, made, title="Nine criteria", unit="balanced accuracy, per cent")
        return Table(
            title="Table 4.1: nine criteria",
            text=words("criteria"),
            sections=(Section(("criterion", "rule, %", "learned from captions, %"), rows),),
            claims=tuple(made),
            picture=Picture("Balanced accuracy by criterion", draw),
        )


def _fit_config(seed: int) -> CriterionConfig:
    seen = {"cameras": list(CAMERAS), "views": list(_VIEWS)}
    widths = {"object_widths": [_WIDTH], "container_width": _CONTAINER}
    return CriterionConfig.from_mapping({"phrases": list(PHRASES), **seen, **widths, "seed": seed})


def _fit_model(config: CriterionConfig, work: Path, on_progress: Callable[[], None]) -> CriterionModel | None:
    """Returns the fitted model; None when the fit was stopped."""
    data, version = dataset_path(_TRAINING, work).name, grounding_version()

    def make_learner() -> CriterionLearner:
        grounding, drawn = open_grounding(), open_or_draw(_TRAINING, work)
        layout = view_layout(
            config.cameras, config.views, config.object_widths, _ASPECT, container_width=config.container_width
        )
        frames = tuple(drawn.seen[camera] for camera in config.cameras)
        moments = KeypointDataset(frames, *find_keypoints(frames, grounding, config, layout), layout)
        parts = moments.split(drawn.seen["lengths"], fraction=config.validation_fraction, seed=config.seed)
        spec, fingerprint = network_spec(grounding, config, layout), f"{data} {version}"
        return CriterionLearner(config, spec, *parts, grounding, version, fingerprint, torch.device("cpu"))

    folder = fit_once(config, [data, version], make_learner, work=work, on_progress=on_progress)
    return None if folder is None else METHOD.load(folder, "cpu")


def _judge(model: CriterionModel, drawn: Drawn) -> Callable[[Asked], Flags]:
    """Returns what tells where a model rewards a goal, bool (M,)."""
    images = model.embed_images({camera: drawn.seen[camera] for camera in CAMERAS}).vectors

    def is_rewarded(goal: Asked) -> Flags:
        said = CriterionCaption(Said.HOLDS, CRITERIA[goal.criterion], tuple(PHRASES[noun] for noun in goal.nouns))
        similarities = model.similarities(images, model.embed_texts((said.text, *said.rivals))[0])
        return np.asarray(similarities[:, 0] > similarities[:, 1:].max(axis=1))

    return is_rewarded


def _judge_by_rule(drawn: Drawn) -> Callable[[Asked], Flags]:
    """Returns what tells where the rule holds of the places that the grounding model gives, bool (M,)."""
    grounding = open_grounding()
    located = {camera: grounding.locate(drawn.seen[camera], PHRASES) for camera in CAMERAS}

    def holds(goal: Asked) -> Flags:
        criterion, nouns = criteria(container_width=_CONTAINER)[goal.criterion], list(goal.nouns)
        found = located[_VIEWS[View(criterion.view)]]
        places = np.stack([found.x[:, nouns], found.y[:, nouns]], axis=2) / _WIDTH  # (M, nouns, 2)
        return np.asarray(criterion.holds(places) & (found.presence[:, nouns] >= _SHOWN).all(axis=1))

    return holds


def _samples(drawn: Drawn, judge: Callable[[Asked], Flags]) -> Iterator[tuple[str, Sample]]:
    """Yields the balanced accuracy of each criterion: answers weigh as much where it holds as where it does not."""
    trial = np.repeat(np.arange(len(drawn.seen["lengths"])), drawn.seen["lengths"])
    by_criterion: dict[str, list[tuple[Flags, Asked]]] = {}
    for goal in asked(drawn.truth["states"]):
        by_criterion.setdefault(goal.criterion, []).append((judge(goal), goal))
    for name, answers in by_criterion.items():
        said, holds, counts = (
            np.stack(each, axis=1)
            for each in zip(*((said, goal.holds, goal.counts) for said, goal in answers), strict=True)
        )
        shares = [max(1, int((counts & (holds == truth)).sum())) for truth in (False, True)]
        weight = counts * np.where(holds, 1 / shares[True], 1 / shares[False]) * counts.sum() / 2  # (M, goals)
        yield name, by_trial(((said == holds) * weight).sum(axis=1), weight.sum(axis=1), trial)


def _claims(method: str, arms: Sequence[ArmResult]) -> Iterator[Claim]:
    for name in CRITERIA:
        samples = [each.samples[name] for each in arms]
        value = _PER_CENT * claims.mean(samples)
        least = _LEAST if method == MODEL else None
        yield claims.claim_of(
            f"{method}_{name}",
            arms,
            samples,
            unit=_PER_CENT,
            seeds=len(arms) if method == MODEL else None,
            target=least,
            met=None if least is None else len(arms) == _SEEDS and value >= least,
            command="python -m experiments run criteria",
        )


def _cell(arms: Sequence[ArmResult], name: str) -> str:
    if not arms:
        return ""
    samples = [each.samples[name] for each in arms]
    low, high = claims.interval(samples)
    return f"{_PER_CENT * claims.mean(samples):.1f} [{_PER_CENT * low:.1f}, {_PER_CENT * high:.1f}]"


EXPERIMENT = NineCriteria()
