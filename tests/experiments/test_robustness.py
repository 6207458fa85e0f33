"""The robustness benchmark: what it draws, its figures as samples, its claims and its table."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from experiments import registry
from experiments.robustness import (
    confidence,
    draw,
    language,
    made_claims,
    policies,
    reward_model,
    scenes,
    segmentation,
    targets,
    unfamiliar,
    visited_states,
    wordings,
    worlds,
)
from experiments.robustness.confidence import Answers
from experiments.robustness.draw import Demonstrations, Exploration, Scenes
from experiments.robustness.heat_map import heat_map
from experiments.robustness.scenes import Judged
from experiments.robustness.visited_states import StoredPolicy
from experiments.workbench import table
from experiments.workbench.arms import Arm
from experiments.workbench.results import ArmResult, Outcome, Sample

from freerein import metrics
from freerein.goal_text import Grammar
from freerein.relations import SpatialRelation
from freerein_reward.methods.relation_captions.caption_dataset import ABSENT

EXPERIMENT = registry.load("robustness")
RNG = np.random.default_rng(0)


def result(arm: Arm, samples: Mapping[str, Sample]) -> ArmResult:
    identity = {"name": arm.name, "world": arm.world, "method": arm.method, "options": arm.options, "seed": arm.seed}
    made = {"config": {}, "world_version": "blocks-v1", "figures": {}, "machine": {}, "command": "python"}
    return ArmResult(**identity, **made, samples=samples, minutes=1.0, cpu_minutes=1.0)


def results(world: str, values: Mapping[str, float], *, seeds: int = 3) -> list[ArmResult]:
    """Results of a fitted model whose figures all have these values, in all trials."""
    samples = {name: Sample([value] * 4, [1] * 4) for name, value in values.items()}
    method = "segmentation" if world == "blocks" else "reward"
    arms = (Arm(world, method, {"fit": "augmented"}, seed) for seed in range(seeds))
    return [result(arm, samples) for arm in arms]


def test_scenes_of_two_conditions_begin_alike_and_look_different() -> None:
    nominal, noisy, two = (
        Scenes(2, 5, "blocks-4").draw(),
        Scenes(2, 5, "blocks-4", "noise-20").draw(),
        Scenes(2, 5, "blocks-2").draw(),
    )
    assert np.array_equal(nominal.truth["states"], noisy.truth["states"])
    assert not np.array_equal(nominal.seen["frames"], noisy.seen["frames"])
    assert (scenes.true_relations(nominal.truth["states"]) != ABSENT).all()
    assert ((scenes.true_relations(two.truth["states"]) != ABSENT).sum(axis=1) == 2).all()


def test_learners_see_no_labels_and_the_tags_are_those_of_the_labels() -> None:
    drawn = Demonstrations(2, 5, 2, 2).draw()
    assert set(drawn.seen) == {"lengths", "frames", "actions", "tags"}
    for tags, labels in zip(drawn.seen["tags"], drawn.by_trajectory("labels"), strict=True):
        assert np.flatnonzero(tags).tolist() == sorted(set(labels.tolist()))


def test_training_and_test_data_have_different_seeds() -> None:
    held_out = {spec.seed for spec in (*segmentation.test_specs().values(), *scenes.scene_specs().values())}
    assert not held_out & {segmentation.TRAINING.seed, reward_model.TRAINING.seed}


def test_what_is_drawn_is_found_by_its_spec_its_kind_and_its_task(tmp_path: Path) -> None:
    specs = (Scenes(2, 5, "blocks-4"), Scenes(2, 6, "blocks-4"), Exploration(2, 5), Demonstrations(2, 5, 2, 2))
    found = [draw.dataset_path(spec, tmp_path) for spec in specs]
    assert len(set(found)) == 4
    assert [draw.dataset_path(spec, tmp_path) for spec in specs] == found


def test_figures_of_confidence_are_those_of_the_metrics() -> None:
    right, trial = RNG.random(500) < 0.8, np.sort(RNG.integers(7, size=500))
    score = np.clip(np.round(RNG.random(500) / 2 + right / 4, 2), 0, 1)
    answers = Answers(right, RNG.random(500), score, trial)

    samples = confidence.samples(answers, nominal=answers)

    kept = score >= confidence.FLAGGED
    ece = metrics.expected_calibration_error(answers.confidence[kept], right[kept], bins=15)
    assert samples[confidence.AUROC].mean == pytest.approx(metrics.auroc(score, right), abs=1e-6)
    assert samples[confidence.CALIBRATION_ERROR].mean == pytest.approx(ece, abs=1e-6)
    assert samples[confidence.FLAGGED_SHARE].mean == pytest.approx(1 - kept.mean(), abs=1e-6)


def test_a_score_is_judged_where_nothing_is_lost_and_where_much_is() -> None:
    trial, one = np.repeat(np.arange(5), 20), np.ones(100)
    flagged, familiar = 0 * one, np.linspace(0.5, 1, 100)
    answers = {
        "nominal": Answers(familiar >= 0.52, one, familiar, trial),
        "harmless": Answers(familiar >= 0.52, one, np.where(trial == 0, flagged, familiar), trial),
        "harmful": Answers(familiar >= 0.9, one, np.where(trial == 0, familiar, flagged), trial),
    }
    figures = unfamiliar.score_figures(answers)
    assert figures[unfamiliar.HARMLESS].mean == pytest.approx(0.2)
    assert figures[unfamiliar.HARMFUL].mean == pytest.approx(0.8)
    assert figures[unfamiliar.WITHIN].mean == pytest.approx(metrics.auroc(answers["harmful"].score, familiar >= 0.9))


def test_effects_change_what_their_names_say() -> None:
    frames = RNG.integers(256, size=(2, 8, 8, 3), dtype=np.uint8)
    seen = {name: effect(frames) for name, effect in unfamiliar.EFFECTS.items()}
    assert all(each.shape == frames.shape and each.dtype == np.uint8 for each in seen.values())
    assert all(each.flags.c_contiguous for each in seen.values())
    assert (np.ptp(seen["gray"], axis=3) == 0).all()
    assert seen["gamma-0.6"].mean() > frames.mean() > seen["gamma-1.6"].mean()
    assert (seen["black"] == 0).all()


def test_answers_of_two_conditions_are_trials_apart() -> None:
    one = Answers(np.array([True, False]), np.ones(2), np.ones(2), np.array([0, 1]))
    assert confidence.pool([one, one]).trial.tolist() == [0, 1, 2, 3]


def test_a_weighted_accuracy_is_the_balanced_accuracy() -> None:
    truth = RNG.choice([0, 1, 1, 4, 4, 4, ABSENT], size=(40, 12))
    relation = np.where(RNG.random(truth.shape) < 0.6, truth, RNG.integers(5, size=truth.shape))
    judged = Judged(relation, RNG.random(truth.shape) < 0.1)

    found = dict(scenes.score(judged, truth, np.full(20, 2)))

    is_shown = truth != ABSENT
    balanced = metrics.balanced_accuracy(relation[is_shown], truth[is_shown])
    assert found[scenes.BALANCED].mean == pytest.approx(balanced, abs=1e-4)
    assert found[scenes.ACCURACY].mean == pytest.approx((relation == truth)[is_shown].mean(), abs=1e-6)
    assert found[scenes.ABSENT_REWARDED].mean == pytest.approx(judged.is_rewarded[~is_shown].mean(), abs=1e-6)
    assert len(found[scenes.BALANCED].totals) == 20


def test_a_converse_says_the_same_as_the_text() -> None:
    grammar = Grammar([f"a {colour} block" for colour in ("red", "green")], [])
    mirrored = {SpatialRelation.LEFT_OF: SpatialRelation.RIGHT_OF, SpatialRelation.ON_TOP_OF: SpatialRelation.BELOW}
    mirrored |= {there: here for here, there in mirrored.items()}
    for relation in SpatialRelation:
        for text in wordings.CLASSES["converse"]("red", relation, "green"):
            statement = grammar.read(text).statement
            assert statement is not None
            assert (statement.first, statement.second) == ("a green block", "a red block")
            assert statement.relation == mirrored.get(relation, relation)


def test_wordings_of_a_class_differ_from_the_trained_ones() -> None:
    for name, wording in wordings.CLASSES.items():
        for relation in SpatialRelation:
            texts = wording("red", relation, "blue")
            assert len(set(texts)) == len(texts)
            is_trained = set(texts) & set(wordings.CLASSES["trained"]("red", relation, "blue"))
            assert bool(is_trained) == (name == "trained")


def test_a_claim_is_the_worst_of_its_conditions() -> None:
    light = {"light-0.6.frame_accuracy": 0.93, "light-0.8.frame_accuracy": 0.91}
    (made,) = made_claims.make_claims(results("blocks", light), [claim_named("seg_light")])
    assert (made.claim.value, made.claim.target, made.claim.met) == (91.0, 92, False)
    assert made.worst == "light-0.8.frame_accuracy"


@pytest.mark.parametrize(("value", "met"), [(0.05, True), (0.051, False)])
def test_where_smaller_is_better_a_claim_must_not_exceed_its_target(value: float, met: bool) -> None:
    samples = {confidence.FLAGGED_SHARE: Sample([value] * 4, [1] * 4)}
    measured = [result(Arm("blocks", unfamiliar.METHOD, {}, seed), samples) for seed in range(3)]
    (made,) = made_claims.make_claims(measured, [claim_named("seg_in_distribution_flagged")])
    assert made.claim.met is met
    assert made.target.must_reach == "≤ 0.05"


@pytest.mark.parametrize(("recall", "met"), [(0.9, True), (0.89, False)])
def test_precision_counts_at_the_recall_that_it_needs_over_all_teachers_and_those_of_the_worst_relation(
    recall: float, met: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    wrong = {"left-of": 0, "right-of": 0, "on-top-of": 0.03}
    teachers = [StoredPolicy(f"blocks.a-{relation}-b", f"a-{relation}-b/1", "") for relation in wrong]
    found = iter([visited(recall=recall, wrong=each) for each in wrong.values()])
    monkeypatch.setattr(visited_states, "evaluate", lambda *_: Outcome({}, next(found)))
    samples = visited_states.evaluate_all(None, teachers, tmp_path).samples  # type: ignore[arg-type]
    arms = [result(Arm("blocks.scatter", visited_states.METHOD, {}, seed), samples) for seed in range(3)]
    names = ("reward_precision", "reward_precision_worst", "reward_recall", "reward_recall_worst")
    wanted = [claim_named(name) for name in names]
    precision, worst, *_ = made_claims.make_claims(arms, wanted)
    assert (precision.claim.seeds, precision.claim.trials, worst.claim.trials) == (3, 12, 4)
    for made, share in ((precision, 0.01), (worst, 0.03)):
        assert made.claim.value == pytest.approx(0.4 * recall / (0.4 * recall + 0.6 * share), abs=1e-4)
        assert made.claim.met is met
    assert worst.worst == "on-top-of.precision-at-0.4"
    assert "teachers, on-top-of" in table.markdown(EXPERIMENT.table(arms))
    assert not made_claims.make_claims(arms[:2], wanted)[0].claim.met


def test_a_claim_needs_all_its_seeds_in_each_of_its_worlds_and_its_row_names_them() -> None:
    left, right = language.SIDES
    samples = {policies.RETURN_ALL: Sample([80] * 4, [80] * 4)}
    arms = [result(Arm(task, policies.PPO, {}, seed), samples) for task in (left, right) for seed in range(5)]
    wanted = [claim_named("ppo_all")]
    (made,), (fewer,) = (made_claims.make_claims(each, wanted) for each in (arms, arms[:-1]))
    assert (made.claim.met, fewer.claim.met) == (True, False)
    assert f"{left}: 0, 1, 2, 3, 4; {right}: 0, 1, 2, 3 |" in table.markdown(EXPERIMENT.table(arms[:-1]))


def visited(*, recall: float, wrong: float) -> dict[str, Sample]:
    """Figures of a reward on 4 episodes of 1 000 states, in 900 of which the goal holds."""
    holds, others = 900, 100
    right, mistaken = recall * holds, wrong * others
    return {
        "precision": Sample([right] * 4, [right + mistaken] * 4),
        "recall": Sample([right] * 4, [holds] * 4),
        "true": Sample([holds] * 4, [holds + others] * 4),
    }


def test_all_runs_of_a_speed_on_the_processor_with_most_of_them_count() -> None:
    rates = {"slow": [1.0], "fast": [7.0, 9.0, 4.0, 8.0, 5.0]}
    arms = [(processor, rate) for processor, each in rates.items() for rate in each]
    made = [
        replace(
            result(
                Arm("blocks.yellow-left-of-green", "ppo_speed", seed=run), {"ticks-per-s-held": Sample([rate], [1])}
            ),
            machine={"processor": processor},
        )
        for run, (processor, rate) in enumerate(arms)
    ]
    (speed,) = made_claims.make_claims(made, [claim_named("ppo_speed_held")])
    assert (speed.claim.value, speed.claim.low, speed.claim.high, speed.claim.trials) == (7.0, 4.0, 9.0, 5)
    assert speed.worst == "fast"


def claim_named(name: str) -> targets.Target:
    (found,) = (target for target in targets.TARGETS if target.claim == name)
    return found


def test_a_table_of_some_results_has_their_claims_and_a_picture() -> None:
    named = {
        name
        for target in targets.TARGETS
        if target.worlds == ("blocks",) and not target.method
        for name in target.samples
    }
    named |= {f"{condition}.frame_accuracy" for condition in worlds.conditions("blocks")}
    made = EXPERIMENT.table(results("blocks", dict.fromkeys(named, 0.97), seeds=2))
    assert {claim.claim for claim in made.claims} >= {"seg_nominal", "seg_light", "seg_hue", "seg_camera"}
    assert all(claim.low <= claim.value <= claim.high and claim.seeds == 2 for claim in made.claims)
    assert "| speed-0.5 | 97.0 |" in table.markdown(made)
    assert made.picture.draw().startswith(b"\x89PNG")


def test_a_heat_map_leaves_missing_cells_blank() -> None:
    picture = heat_map({("a", "g, x"): 5.0}, rows=("a", "b"), groups={"g": ["x"], "h": ["x", "y"]}, title="")
    assert picture.startswith(b"\x89PNG")
