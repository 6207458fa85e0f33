"""Demonstrations, the supervised learner, and the scoring of labels."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from experiments.segmentation import (
    dataset,
    draw,
    evaluation,
    guesses,
    supervised,
    trials,
    truth,
    weakly_supervised,
)
from experiments.segmentation.dataset import DatasetSpec, SplitSpec
from experiments.segmentation.decoded import Decoded, boundary_errors, moved
from experiments.segmentation.experiment import WorkbenchLearner, fit_in_turn
from experiments.segmentation.packed import pack, unpack
from experiments.segmentation.rows import Row, Rows
from experiments.segmentation.study import Method, Study
from experiments.segmentation.targets import DECODED_TEST_ACCURACY, TEST_ACCURACY, Target
from experiments.workbench.arms import Arm
from experiments.workbench.results import ArmResult, Sample

from freerein.errors import InvalidInput
from freerein.learning.training_loop import TrainingFailed
from freerein_segmentation.model import SegmentationModel
from freerein_segmentation.training import SegmentationConfig

DATA = DatasetSpec("grid", train=SplitSpec(9, 2, 4), validation=SplitSpec(3, 2, 4), test=SplitSpec(3, 5, 5))
CONFIG = SegmentationConfig(batch_size=4, context=0, lr=0.02, features=16, hidden_size=32)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(Path(__file__).parents[2])
        return dataset.open_or_draw(DATA, tmp_path_factory.mktemp("work"))


def test_a_dataset_is_drawn_once_and_found_by_its_spec_and_the_version_of_its_world(folder: Path) -> None:
    before = (folder / "train").stat()
    assert dataset.open_or_draw(DATA, folder.parents[1]) == folder
    assert (folder / "train").stat().st_mtime_ns == before.st_mtime_ns
    others = [replace(DATA, seed=1), replace(DATA, task="grid-no-indicator")]
    assert len({folder, *(dataset.folder_of(spec, folder.parents[1]) for spec in others)}) == 3
    made_by = json.loads(folder.with_name(f"{folder.name}.json").read_bytes())
    assert made_by["world_version"] == "grid-v1"


def test_a_trajectory_does_not_depend_on_the_part_that_it_is_drawn_in(folder: Path, tmp_path: Path) -> None:
    draw.main(tmp_path, draw.Part("grid", 0, dataset.SPLITS.index("train"), 2, 4, first=4, stop=6))
    train = dataset.open_split(folder, DATA, "train")
    drawn = np.fromfile(tmp_path / "frames", np.uint8)
    assert np.array_equal(drawn, np.concatenate([train.frames["top"][item] for item in (4, 5)]).ravel())


def test_the_tags_of_a_trajectory_are_the_skills_of_its_true_labels(folder: Path) -> None:
    skills = DATA.world.skills
    for name in dataset.SPLITS:
        split, labels, spec = dataset.open_split(folder, DATA, name), truth.open_labels(folder, name), DATA.split(name)
        assert len(split) == spec.count
        assert split.frames["top"][0].shape[1:] == (33, 30, 3)
        for index, tags in enumerate(split.skills):
            assert len(labels[index]) == len(split.actions[index])
            assert {skills[label] for label in labels[index]} == set(tags)
            assert spec.least_skills <= len(tags) <= spec.most_skills


def test_true_labels_lie_where_no_learner_reads(folder: Path) -> None:
    assert {path.name for path in (folder / "train").iterdir()} == {
        "frames.raw",
        "actions.raw",
        "lengths.raw",
        "tags.raw",
    }


def test_the_supervised_learner_starts_with_the_same_weights_and_its_loss_falls(folder: Path) -> None:
    weak = weakly_supervised.make_learner(CONFIG, DATA, folder)
    learner = supervised.make_learner(CONFIG, DATA, folder)
    state, other = (each.init(torch.Generator().manual_seed(0)) for each in (learner, weak))
    assert all(map(torch.equal, state.network.state_dict().values(), other.network.state_dict().values()))
    assert learner.evaluate(state) == pytest.approx(np.log(5), abs=0.1)

    losses = []
    for _ in range(20):
        state, metrics = learner.update(state, np.arange(4))
        losses.append(metrics["train_loss"])

    assert losses[-1] < losses[0] / 2


@pytest.mark.parametrize("stride", [1, 3])
def test_predictions_do_not_depend_on_the_batch_and_are_the_services(stride: int, folder: Path) -> None:
    weak = weakly_supervised.make_learner(replace(CONFIG, stride=stride), DATA, folder)
    network = weak.init(torch.Generator().manual_seed(0)).network
    together = evaluation.predict(network, weak.training, count=9)
    alone = [evaluation.predict(network, weak.training.subset([index]), count=1)[0] for index in range(9)]
    assert [len(each) for each in together] == weak.training.lengths().tolist()
    model = SegmentationModel(network)
    for index, probabilities in enumerate(together):
        np.testing.assert_allclose(probabilities, alone[index], atol=1e-6)
        served = model.predict(weak.training.frames["top"][index], weak.training.actions[index])
        np.testing.assert_allclose(probabilities, served.probabilities, atol=1e-6)


def test_perfect_labels_score_one_and_an_unknown_method_is_refused(folder: Path) -> None:
    known = truth.first_labels(folder, "test", 3)
    outcome = evaluation.score_guess(known, known, split="test")
    assert set(outcome.figures.values()) == {1.0}
    assert outcome.samples["test.frame_accuracy"].counts == [len(each) for each in known]
    with pytest.raises(InvalidInput, match="objective"):
        SegmentationConfig.from_mapping({"objective": "telepathy"})


def test_guesses_are_as_good_as_chance_allows() -> None:
    rng, truth_labels = np.random.default_rng(0), np.array([0, 0, 0, 1] * 500)
    accuracy = {
        guess.__name__: float(np.mean(guess(truth_labels, skills=5, rng=rng) == truth_labels))
        for guess in (guesses.guess_skill, guesses.guess_tag, guesses.guess_majority)
    }
    assert accuracy["guess_skill"] == pytest.approx(0.2, abs=0.03)
    assert accuracy["guess_tag"] == pytest.approx(0.5, abs=0.04)
    assert accuracy["guess_majority"] == 0.75


def test_a_fixed_split_gives_each_half_its_skill() -> None:
    labels = guesses.split_in_half(np.array([4, 4, 4, 4, 1]), skills=5, rng=np.random.default_rng(0))
    assert labels.tolist() == [4, 4, 4, 1, 1]


def test_short_segments_are_rejected_and_what_is_kept_is_scored() -> None:
    truth_labels = np.repeat([0, 1, 0], [6, 5, 9])
    predicted = np.repeat([0, 1, 2, 0], [7, 4, 3, 6])
    assert evaluation.reject_short(predicted).tolist() == [0] * 7 + [-1] * 7 + [0] * 6

    one_hot = np.eye(3, dtype=np.float32)[predicted]
    outcome = evaluation.score([one_hot], [evaluation.decode(one_hot)], [truth_labels], split="validation")

    assert outcome.figures["validation.unsmoothed_kept_share"] == pytest.approx(13 / 20)
    assert outcome.figures["validation.unsmoothed_kept_accuracy"] == pytest.approx(12 / 13, abs=1e-6)
    assert outcome.figures["validation.unsmoothed_least_kept_share"] == pytest.approx(1 / 5)


def test_uncertain_timesteps_are_rejected_too() -> None:
    first = np.repeat([0.95, 0.6], 20)  # of skill 0, which is wrong from timestep 20 on
    probabilities = np.stack([first, 1 - first], axis=1).astype(np.float32)
    assert evaluation.reject_uncertain(probabilities).tolist() == [0] * 20 + [-1] * 20

    decoded = evaluation.decode(probabilities)
    outcome = evaluation.score([probabilities], [decoded], [np.repeat([0, 1], 20)], split="validation")

    assert outcome.figures["validation.kept_accuracy"] == 0.5
    assert outcome.figures["validation.confident_kept_accuracy"] == 1
    assert outcome.figures["validation.confident_kept_share"] == pytest.approx(0.5, abs=0.05)


def test_labels_that_are_late_are_as_late_as_they_were_made_and_come_right_when_moved() -> None:
    truth_labels = np.repeat([0, 3, 1], [9, 6, 5])
    late = np.repeat([0, 3, 1], [11, 6, 3])
    assert boundary_errors(late, truth_labels) == [2, 2]
    assert boundary_errors(truth_labels, late) == [-2, -2]
    assert boundary_errors(np.repeat([3, 1], [15, 5]), truth_labels) == [0]  # skill 3 never begins
    assert moved(late, 2).tolist() == truth_labels.tolist()
    decoded = Decoded([[late], [truth_labels]], [truth_labels])
    assert decoded.boundary_error() == (1.0, 1.0)
    assert [sample.mean for sample in decoded.samples()] == [0.8, 1.0]
    assert Decoded([[late]], [truth_labels]).best_delay() == 2


def test_an_order_in_equal_parts_keeps_nothing_of_durations() -> None:
    assert guesses.in_equal_parts(np.repeat([2, 0, 2], [1, 1, 7])).tolist() == [2, 2, 2, 0, 0, 0, 2, 2, 2]
    assert guesses.in_equal_parts(np.repeat([2, 0], [4, 1])).tolist() == [2, 2, 2, 0, 0]


def test_labels_that_are_packed_come_back() -> None:
    labels = [np.array([0, 0, 255]), np.array([7])]
    assert [each.tolist() for each in unpack(pack(labels), [3, 1])] == [[0, 0, 255], [7]]
    with pytest.raises(ValueError, match=r"\[0, 255\]"):
        pack([np.array([-1])])


@pytest.mark.parametrize(
    ("config", "guessed"),
    [
        (SegmentationConfig(objective="lse"), math.log(4)),
        (SegmentationConfig(objective="mil"), math.log(4)),
        (SegmentationConfig(final_objective="set_likelihood"), 0.1 * math.log(4) + math.log(2)),
    ],
)
def test_a_network_that_knows_nothing_has_the_loss_of_guessing(config: SegmentationConfig, guessed: float) -> None:
    tags = np.array([[True, True, False, False], [False, False, True, True]])  # each skill in every other trajectory
    assert evaluation.guessed_tag_loss(config, tags) == pytest.approx(guessed, abs=1e-6)


def test_guessing_is_the_best_constant_of_each_objective() -> None:
    tags = np.array([[True, True, False, False]] * 6 + [[True, False, True, False]] * 3 + [[True, False, False, True]])
    found = {name: evaluation.guessed_tag_loss(SegmentationConfig(objective=name), tags) for name in ("ccnn", "lse")}
    shares = [0.5, 0.3, 0.15, 0.05]  # of each skill, half a tag each
    assert found["lse"] == pytest.approx(-sum(share * math.log(share) for share in shares), abs=1e-6)
    assert found["ccnn"] < 0.1  # a little of all skills is allowed wherever they may occur


STUDY = Study(
    DATA,
    methods=(Method("lse", ("causal",), {"objective": "lse"}),),
    seeds=2,
    settings={"steps": 8, "lr": 0.5},
    train_evaluated=9,
    learning_rates=(0.01, 0.001, 0.1),
    trial_steps=2,
)


def test_trials_choose_the_learning_rate_of_the_lowest_loss_once_for_all_seeds(tmp_path: Path) -> None:
    losses, fitted = {0.01: 2.0, 0.001: 1.0, 0.1: 3.0, 0.00033: 1.5}, []

    def fit(config: SegmentationConfig, folder: Path) -> float:
        fitted.append((config.lr, config.steps, config.seed))
        return losses[config.lr]

    def choose(study: Study, seed: int) -> float:
        arm = Arm("grid", "lse", {"context": "causal"}, seed)
        ranked = trials.rank_lrs(study, arm, fit, results=tmp_path / "r", work=tmp_path / "w")
        assert ranked == {lr: losses[lr] for lr in (0.001, 0.00033, 0.01, 0.1)}
        return next(iter(ranked))

    assert [choose(STUDY, seed=1), choose(STUDY, seed=0)] == [0.001, 0.001]
    assert fitted == [(0.01, 2, 0), (0.001, 2, 0), (0.1, 2, 0), (0.00033, 2, 0)]  # until the best is between others
    assert choose(replace(STUDY, trial_steps=4), seed=0) == 0.001
    assert [steps for _, steps, _ in fitted] == [2] * 4 + [4] * 4

    path = tmp_path / "r" / "trials" / "grid-lse-causal.json"
    made = json.loads(path.read_bytes())
    del made["made_by"]["fit"]["rounds"]  # as before the key, which has a default, was added
    path.write_text(json.dumps(made))
    assert choose(replace(STUDY, trial_steps=4), seed=0) == 0.001
    assert len(fitted) == 8


def test_a_rate_under_which_training_fails_is_tried_and_not_chosen(tmp_path: Path) -> None:
    def fit(config: SegmentationConfig, folder: Path) -> float:
        if config.lr >= 0.1:
            raise TrainingFailed("An image encoder is dead.")
        return 1 / config.lr

    arm = Arm("grid", "lse", {"context": "causal"})
    assert trials.rank_lrs(STUDY, arm, fit, results=tmp_path / "r", work=tmp_path / "w") == {0.01: 100, 0.001: 1000}
    (made,) = (tmp_path / "r" / "trials").glob("*.json")
    assert json.loads(made.read_bytes())["validation_loss"] == {"0.001": 1000, "0.01": 100, "0.1": None}


def test_where_training_fails_or_ends_worse_than_its_trial_the_next_learning_rate_is_fitted(
    folder: Path, tmp_path: Path
) -> None:
    def make_learner(lr: float) -> WorkbenchLearner:
        if lr > 0.1:
            raise TrainingFailed("An image encoder is dead.")
        config = replace(CONFIG, lr=lr, steps=4, warmup_steps=1, evaluate_every=2, checkpoint_every=2, log_every=1)
        return weakly_supervised.make_learner(config, DATA, folder)

    def chosen(lrs: dict[float, float]) -> float:
        learner, fitted = fit_in_turn(make_learner, lrs, tmp_path, lambda: None)
        assert fitted is not None
        return learner.config.lr

    assert chosen({0.5: math.inf, 0.02: math.inf, 0.01: math.inf}) == 0.02
    assert chosen({0.5: math.inf, 0.02: 1e-6, 0.01: math.inf}) == 0.01
    assert chosen({0.02: 1e-6, 0.01: 1e-6}) in (0.02, 0.01)
    with pytest.raises(TrainingFailed):
        fit_in_turn(make_learner, {0.5: math.inf}, tmp_path, lambda: None)


def test_a_method_with_a_learning_rate_of_its_own_tries_none() -> None:
    published = Method("published", ("causal",), {"objective": "lse", "lr": 1e-4})
    study = replace(STUDY, methods=(*STUDY.methods, published))
    tried, set_ = (Arm("grid", name, {"context": "causal"}) for name in ("lse", "published"))
    assert [study.tries_learning_rates(arm) for arm in (tried, set_)] == [True, False]
    assert study.fit_config(set_).lr == 1e-4


def test_contexts_have_names() -> None:
    contexts = ("causal", "lookahead-5", "bidirectional")
    study = replace(STUDY, methods=(Method("lse", contexts, {"objective": "lse"}),))
    networks = [arm for arm in study.arms if not study.is_guess(arm)][:3]
    assert [study.fit_config(arm).context for arm in networks] == [0, 5, "all"]
    assert networks[1].name == "grid-lse-lookahead-5-seed0"


def test_trials_end_before_the_final_objective(tmp_path: Path) -> None:
    ours = Method("lse", ("causal",), {"final_objective": "self_training", "action_evidence": 0.5})
    fitted: list[SegmentationConfig] = []

    def fit(config: SegmentationConfig, folder: Path) -> float:
        fitted.append(config)
        return abs(config.lr - 0.01)

    study = replace(STUDY, methods=(ours,))
    trials.rank_lrs(study, study.arms[-1], fit, results=tmp_path / "r", work=tmp_path / "w")
    assert {(each.final_objective, each.action_evidence) for each in fitted} == {("none", 0.0)}


def test_a_trial_that_was_stopped_chooses_nothing(tmp_path: Path) -> None:
    arm = STUDY.arms[-1]
    ranked = trials.rank_lrs(STUDY, arm, lambda *_: None, results=tmp_path / "r", work=tmp_path)
    assert ranked is None
    assert not (tmp_path / "r").exists()


def rows_with(**accuracies: float) -> Rows:
    """Returns the rows of three networks each, named by method and context."""
    names = {"lse": Row("lse", "causal"), "ours": Row("ours", "all"), "bound": Row("supervised", "all")}
    names["fcn_mil"] = Row("fcn_mil", "causal")
    results = [
        ArmResult(
            name="",
            world="dial",
            method=names[name].method,
            options={"context": names[name].context},
            seed=seed,
            config={"fit": {"objective": names[name].method}},
            world_version="dial-v1",
            figures={"validation.kept_share": accuracy, "validation_loss": 1.0, "action_loss": 1.0},
            samples={TEST_ACCURACY: Sample([100 * accuracy] * 20, [100] * 20)},
            minutes=0,
            cpu_minutes=0,
            machine={},
            command="",
        )
        for name, accuracy in accuracies.items()
        for seed in range(3)
    ]
    return Rows.of(results, "dial")


def rows_of(method: str, losses: dict[str, tuple[float, float]], **figures: float) -> list[ArmResult]:
    """Returns three networks of a method in each context, with its losses of held-out tags and of actions."""
    return [
        replace(
            each,
            options={"context": context},
            config={"fit": {"objective": method}},
            method=method,
            figures={"validation_loss": tags, "action_loss": actions, **figures},
        )
        for context, (tags, actions) in losses.items()
        for rows in rows_with(ours=0.8).arms.values()
        for each in rows
    ]


def test_tags_choose_between_contexts_and_actions_between_objectives() -> None:
    ours = rows_of("ours", {"all": (0.2, 1.0), "lookahead-5": (0.1, 1.1)})
    others = rows_of("ours_from_lse", {"all": (0.5, 1.2), "causal": (0.6, 0.9)})
    rows = Rows.of([*ours, *others], "dial")
    assert rows.chosen(rows.arms) == Row("ours", "lookahead-5")
    assert rows.chosen([Row("ours", "all"), Row("ours_from_lse", "causal")]) == Row("ours_from_lse", "causal")
    assert rows.chosen([Row("mil", "causal")]) is None


def test_a_row_that_was_undecided_before_self_training_counts_only_where_all_are() -> None:
    undecided = rows_of("ours", {"all": (0.5, 0.5), "lookahead-5": (0.6, 0.6)}, is_decided=0.0)
    whole, short, decided = Row("ours", "all"), Row("ours", "lookahead-5"), Row("ours_from_lse", "causal")
    assert Rows.of(undecided, "dial").chosen((short, whole)) == whole
    rows = Rows.of([*undecided, *rows_of("ours_from_lse", {"causal": (0.9, 0.9)})], "dial")
    assert rows.chosen((short, whole, decided)) == decided


def test_ours_is_compared_with_the_dissertations_method_in_the_dissertations_context() -> None:
    whole = rows_of("lse", {"all": (0.5, 0.5)})
    rows = Rows.of([*(each for row in rows_with(lse=0.6, ours=0.8).arms.values() for each in row), *whole], "dial")
    assert rows.baseline(Row("ours", "all"), TEST_ACCURACY) == pytest.approx(60)
    assert rows.baseline(Row("lse", "all"), TEST_ACCURACY) is None
    assert rows.best_baseline(TEST_ACCURACY) == pytest.approx(80)
    assert Rows.of(rows_of("ours", {"all": (0.5, 0.5)}), "dial").best_baseline(TEST_ACCURACY) is None


def test_a_gap_counts_from_the_best_baseline_and_decoded_where_that_is_less() -> None:
    decoded = {"lse": 0.7, "fcn_mil": 0.9, "ours": 0.92, "bound": 1.0}
    rows = rows_with(lse=0.6, fcn_mil=0.8, ours=0.9, bound=1.0)
    with_decoded = Rows(
        {
            row: [
                replace(arm, samples={**arm.samples, DECODED_TEST_ACCURACY: Sample([100 * share] * 20, [100] * 20)})
                for arm in arms
            ]
            for (row, arms), share in zip(rows.arms.items(), decoded.values(), strict=True)
        }
    )
    ours = Row("ours", "all")
    gaps = with_decoded.gaps(ours, (TEST_ACCURACY, DECODED_TEST_ACCURACY))
    assert gaps == pytest.approx([0.75, 0.5, 0.22 / 0.3, 0.2])
    missing = Target("claim", "dial", (ours,), least_gap_closed=0.5).missing(with_decoded)
    assert missing == ["gap closed 0.20 is below 0.5", "1 of 5 gaps not measured, or too small to be"]


def test_a_network_that_knows_no_more_of_the_tags_than_guessing_is_not_trained() -> None:
    known, unknown = (rows_of("mil", {"causal": (loss, 1.0)}, guessed_validation_loss=1.0) for loss in (0.9, 0.99))
    row = Row("mil", "causal")
    assert [Rows.of(each, "dial").is_trained(row) for each in (known, unknown)] == [True, False]


@pytest.mark.parametrize(
    ("target", "rows", "missing"),
    [
        ({"least_gap_closed": 0.75}, rows_with(lse=0.6, ours=0.9, bound=1.0), "3 of 5 gaps not measured"),
        ({"least_gap_closed": 0.75}, rows_with(ours=0.9), "5 of 5 gaps not measured"),
        ({"least": 99.95}, rows_with(ours=0.9994), "99.94 is below 99.95"),
        ({"above": 59.93}, rows_with(lse=0.55, ours=0.9), ""),
        ({"above": 59.93}, rows_with(lse=0.5, ours=0.9), "more than 5 points under"),
        ({"above": 59.93}, rows_with(lse=0.55, ours=0.59), "59.00 is not above"),
        ({"above_row": Row("lse", "causal")}, rows_with(lse=0.6, ours=0.7), ""),
        ({"above_row": Row("lse", "causal")}, rows_with(lse=0.7, ours=0.7), "is not above that of lse"),
        ({"least": 50, "least_figures": {"validation.kept_share": 0.8}}, rows_with(ours=0.7), "0.700, below 0.8"),
        ({"least": 50, "seeds": 5}, rows_with(ours=0.7), "3 of 5 seeds"),
    ],
)
def test_a_claim_is_met_only_with_all_that_it_needs(target: dict[str, Any], rows: Rows, missing: str) -> None:
    found = Target("claim", "dial", (Row("ours", "all"),), **target).missing(rows)
    assert (missing in found[0] and len(found) == 1) if missing else not found


def test_a_claim_may_leave_out_trajectories_that_were_looked_at() -> None:
    ours = Row("ours", "all")
    (result, *_) = rows_with(ours=0.8).arms[ours]
    rows = Rows.of([replace(result, samples={TEST_ACCURACY: Sample([0, 0, 9, 8], [10, 10, 10, 10])})], "dial")
    target = Target("claim", "dial", (ours,), first_trial=2)
    assert target.counted(rows).value(ours, TEST_ACCURACY) == pytest.approx(85)
    assert rows.value(ours, TEST_ACCURACY) == pytest.approx(42.5)
