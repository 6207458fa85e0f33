from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch

from freerein import metrics
from freerein.errors import InvalidInput
from freerein.learning import weights
from freerein.learning.inputs import spec_of
from freerein.learning.training_loop import FitResult, TrainingFailed, fit
from freerein.learning.trajectories import Trajectories
from freerein.types.common import ActionSpec, Camera
from freerein.types.segmentation import FLAGGED
from freerein_segmentation import training
from freerein_segmentation.model import ModelSpec, SegmentationModel
from freerein_segmentation.training import Confidence, SegmentationConfig, SegmentationLearner, self_training

SKILLS = ("blue", "green", "red")
COLOURS = np.array([[40, 40, 220], [40, 220, 40], [220, 40, 40]], np.uint8)
CAMERAS = (Camera("front", 12, 12, 3),)
ACTION = ActionSpec(2, 0, ("dy", "dz"), "m", (0.05, 0.05))
STEPS = ActionSpec(1, 5, ("step",), "", (1.0,))
CPU = torch.device("cpu")
FAST = SegmentationConfig(
    steps=50, batch_size=8, lr=1e-2, warmup_steps=5, hidden_size=16, features=16, evaluate_every=10
)
STEADY = {"steps": 100, "lr": 5e-3, "warmup_steps": 10}  # where the tags say less of a timestep


@pytest.fixture(autouse=True)
def _small_action_models(monkeypatch: pytest.MonkeyPatch) -> None:
    """Action models of few updates, which suffice for what happens here."""
    monkeypatch.setattr(self_training, "_STEPS", 20)


def make(count: int, *, seed: int, skills: int = 2) -> tuple[Trajectories, list[npt.NDArray[np.int64]]]:
    """Returns noisy frames with a coloured dot, and the labels: the skill of a timestep is the colour of its dot."""
    rng = np.random.default_rng(seed)
    frames, actions, labels = [], [], []
    for _ in range(count):
        truth = np.repeat(rng.permutation(3)[:skills], rng.integers(3, 8, skills))
        seen = rng.integers(100, 130, (len(truth), 12, 12, 3), np.uint8)
        seen[:, 2:6, 2:6] = COLOURS[truth][:, None, None]
        frames.append(seen)
        actions.append(rng.uniform(-1, 1, (len(truth), 2)).astype(np.float32))
        labels.append(truth.astype(np.int64))
    tags = [tuple(SKILLS[skill] for skill in np.unique(truth)) for truth in labels]
    return Trajectories({"front": frames}, actions, tags), labels


def learner(config: SegmentationConfig = FAST) -> SegmentationLearner:
    learnt, _ = make(48, seed=0)
    held_out, _ = make(8, seed=1)
    spec = spec_of(config, ModelSpec, cameras=CAMERAS, action=ACTION, skills=SKILLS)
    return SegmentationLearner(config, spec, learnt, held_out, "fingerprint", CPU)


@pytest.mark.parametrize(
    "change",
    [
        {"objective": "lse"},
        {"objective": "ccnn", **STEADY},
        {"context": 2, "final_objective": "set_likelihood"},
        {"final_objective": "self_training", "action_evidence": 0.3, "tag_context": 0, "rounds": 2},
    ],
    ids=lambda change: "-".join(str(value) for key, value in change.items() if key not in STEADY),
)
def test_skills_are_located_from_tags_alone_in_trajectories_of_more_skills_than_trained_on(
    tmp_path: Path, change: dict[str, Any]
) -> None:
    config = replace(FAST, augmentation=0.0, **change)
    fitted = fit(learner(config), tmp_path)
    assert fitted is not None
    model, (unseen, labels) = SegmentationModel(fitted.network), make(10, seed=2, skills=3)
    predicted = [
        model.predict(frames, actions).probabilities.argmax(axis=1)
        for frames, actions in zip(unseen.frames["front"], unseen.actions, strict=True)
    ]
    accuracy = np.mean([metrics.frame_accuracy(*pair) for pair in zip(predicted, labels, strict=True)])
    assert accuracy > 0.95


def test_held_out_timesteps_have_every_in_distribution_score_alike_and_other_pictures_have_none(tmp_path: Path) -> None:
    fits = replace(
        learner(replace(FAST, steps=30, evaluate_every=15, augmentation=0.0)), validation=make(20, seed=1)[0]
    )
    fitted = fit(fits, tmp_path)
    assert fitted is not None
    fits.calibrate(fitted.network)
    model, held_out = SegmentationModel(fitted.network), fits.validation
    pairs = zip(held_out.frames["front"], held_out.actions, strict=True)
    scores = np.concatenate([model.predict(*pair).in_distribution for pair in pairs])
    assert np.quantile(scores, (0.25, 0.5, 0.75)) == pytest.approx((0.25, 0.5, 0.75), abs=0.05)
    stripes = np.zeros((20, 12, 12, 3), np.uint8)
    stripes[:, ::2] = 255
    assert model.predict(stripes, np.zeros((20, 2), np.float32)).in_distribution.max() < FLAGGED


class _Blind(SegmentationLearner):
    """A learner whose encoder lets nothing through from the start."""

    def init(self, generator: torch.Generator) -> Any:
        state = super().init(generator)
        stem: Any = state.network.image.encoders[0].stem
        torch.nn.init.constant_(stem.bias, -1e6)
        return state


def test_a_fit_whose_encoder_is_dead_fails_and_says_so(tmp_path: Path) -> None:
    seeing = learner()
    blind = _Blind(**{each.name: getattr(seeing, each.name) for each in fields(seeing)})
    with pytest.raises(TrainingFailed, match="camera front has the same features for all training frames") as failed:
        fit(blind, tmp_path)
    assert "`warmup_steps`" in failed.value.hint


def test_the_same_seed_gives_the_same_weights_and_another_seed_others(tmp_path: Path) -> None:
    def digest(name: str, seed: int) -> str:
        config = replace(FAST, steps=5, seed=seed)
        fitted = fit(learner(config), tmp_path / name)
        assert fitted is not None
        return weights.sha256(fitted.network)

    assert digest("first", 0) == digest("again", 0) != digest("other", 1)


def test_a_fit_that_is_stopped_in_its_last_stage_goes_on_to_the_same_bits(tmp_path: Path) -> None:
    short = replace(FAST, steps=12, evaluate_every=4, checkpoint_every=5, log_every=3, stride=3)
    stages = {"final_objective": "self_training", "action_evidence": 0.3, "tag_context": 1, "final_share": 0.7}
    config = replace(short, rounds=2, **stages)
    asked = iter(range(8))
    whole = fit(learner(config), tmp_path / "whole")
    assert fit(learner(config), tmp_path / "parts", stop=lambda: next(asked) == 7) is None
    parts = fit(learner(config), tmp_path / "parts")
    assert whole is not None
    assert parts is not None
    assert weights.sha256(whole.network) == weights.sha256(parts.network)
    assert whole.best_step > config.steps - learner(config).stages()[-1].steps
    rows = [(tmp_path / name / "metrics.jsonl").read_text() for name in ("whole", "parts")]
    assert rows[0] == rows[1]


def test_the_loss_on_held_out_trajectories_is_their_mean_however_they_are_batched() -> None:
    whole = learner(replace(FAST, augmentation=0.0))
    state = whole.init(torch.Generator().manual_seed(0))
    one_by_one = replace(whole, config=replace(whole.config, batch_size=1))
    assert one_by_one.evaluate(state) == pytest.approx(whole.evaluate(state), abs=1e-6)


def test_the_loss_on_held_out_trajectories_counts_augmented_frames_that_are_drawn_alike_each_time() -> None:
    whole, plain = learner(), learner(replace(FAST, augmentation=0.0))
    state = whole.init(torch.Generator().manual_seed(0))
    assert whole.evaluate(state) == whole.evaluate(state) != plain.evaluate(state)


@pytest.mark.parametrize("final_objective", ["set_likelihood", "self_training"])
def test_the_confidence_is_of_the_network_before_its_final_objective(final_objective: str) -> None:
    whole = learner(replace(FAST, steps=3, final_objective=final_objective, final_share=0.7, augmentation=0.0))
    state, _ = whole.update(whole.init(torch.Generator().manual_seed(0)), np.arange(8))
    before = whole.confidence(FitResult(state.network, 1, 0.0))
    for _ in range(2):
        state, _ = whole.update(state, np.arange(8))
    assert whole.confidence(FitResult(state.network, 3, 0.0)) != before
    assert whole.confidence(FitResult(state.network, 3, 0.0, state.carried)) == before


def test_only_trajectories_with_two_tags_say_whether_a_network_is_decided() -> None:
    highest = torch.tensor([1.0, 0.5, 0.75, 1.0])
    assert Confidence.over(highest, torch.tensor([1, 2, 2, 1])) == Confidence(0.625, 0.5)
    assert not Confidence(0.625, 0.5).is_decided
    alone = Confidence.over(highest, torch.ones(4, dtype=torch.int64))
    assert (alone.is_decided, alone.has_choice) == (True, False)


def test_a_configuration_is_read_strictly_from_the_numbers_of_a_struct() -> None:
    config = SegmentationConfig.from_mapping({"steps": 20.0, "objective": "lse", "threads": 2.0})
    assert config == SegmentationConfig(steps=20, objective="lse", threads=2)
    assert SegmentationConfig.from_mapping({"context": 5.0}).context == 5
    assert SegmentationConfig.from_mapping({"context": "all"}) == SegmentationConfig()
    for wrong in (
        *({"labels": True}, {"steps": 0}, {"objective": "supervised"}),
        *({"context": context} for context in (-1, 0.5, 201, "causal", None)),
    ):
        with pytest.raises(InvalidInput):
            SegmentationConfig.from_mapping(wrong)


def test_discrete_actions_and_no_actions_are_learnt_from_too() -> None:
    learnt, _ = make(4, seed=0)
    steps = [np.zeros((length, 1), np.int64) for length in learnt.lengths()]
    discrete = replace(learnt, actions=steps)
    for config in (FAST, replace(FAST, use_actions=False)):
        spec = spec_of(config, ModelSpec, cameras=CAMERAS, action=STEPS, skills=SKILLS)
        whole = SegmentationLearner(config, spec, discrete, discrete, "fingerprint", CPU)
        state, figures = whole.update(whole.init(torch.Generator().manual_seed(0)), np.arange(4))
        assert state.step == 1
        assert np.isfinite(figures["train_loss"])


def test_with_a_stride_each_update_sees_other_timesteps_and_short_trajectories_still_count() -> None:
    learnt, _ = make(2, seed=0)
    spec = spec_of(replace(FAST, stride=5), ModelSpec, cameras=CAMERAS, action=ACTION, skills=SKILLS)
    batch = training.gather(learnt, [0, 1], [2, 4], spec=spec, device=CPU)
    frames = learnt.frames["front"]
    expected = [frames[0][2::5], frames[1][4::5]]
    assert batch.lengths.tolist() == [len(each) for each in expected]
    np.testing.assert_array_equal(batch.frames["front"].numpy(), np.concatenate(expected))
    brief = Trajectories({"front": [frames[0][:3]]}, [learnt.actions[0][:3]], [SKILLS[:1]])
    assert training.gather(brief, [0], [4], spec=spec, device=CPU).lengths.tolist() == [1]
