"""Arms of the robustness benchmark that train policies: their pipelines, and figures from trials."""

import os
from pathlib import Path

import numpy as np
import pytest
from experiments.robustness import evaluated, language, policies
from experiments.robustness.target import Target
from experiments.workbench.pipelines import fit_step, run_once, run_pipeline, step

from freerein import metrics
from freerein_imitation.model.known_texts import KnownTexts
from freerein_orchestrator.kinds import KINDS

RNG = np.random.default_rng(0)


def test_the_orchestrator_takes_the_pipeline_of_every_arm_and_evaluates_on_seeds_of_no_training() -> None:
    for arm in policies.arms(seeds=1):
        steps = policies.METHODS[arm.method].steps(arm)
        KINDS["pipeline"].parse({"steps": [*steps]})
        held_out = {step["config"]["seed"] for step in steps if step["kind"] == "evaluate"}
        assert held_out, arm.name
        assert arm.seed not in held_out, arm.name


def test_a_flag_is_judged_on_all_visited_states() -> None:
    lengths = RNG.integers(5, 40, 30)
    right = [RNG.random(length) < 0.3 for length in lengths]
    score = [np.clip(np.round(RNG.normal(0.3 + 0.4 * each, 0.2), 2), 0, 1) for each in right]
    trials = [
        {"confidence": own, "at_landmark": at.tolist(), "moves": [False, True], "recognized": [True, bool(at[0])]}
        for own, at in zip(score, right, strict=True)
    ]
    found = policies.METHODS[policies.GOAL_CLONING].samples({"landmarks": trials})

    scores, rights = np.concatenate(score), np.concatenate(right)
    assert found[evaluated.FLAG_AUROC].mean == pytest.approx(metrics.auroc(scores, rights), abs=1e-6)
    ece = metrics.expected_calibration_error(scores, rights, bins=15)
    assert found[evaluated.FLAG_ECE].mean == pytest.approx(ece, abs=1e-6)
    recalls = [
        rights[scores >= threshold].sum() / rights.sum()
        for threshold in np.unique(scores)
        if rights[scores >= threshold].mean() >= 0.9
    ]
    assert found[evaluated.FLAG_RECALL].mean == pytest.approx(max(recalls))
    assert found[policies.LANDMARKS_FREE].mean == 1
    assert found[policies.LANDMARKS_BLOCK].mean == pytest.approx(np.mean([each[0] for each in right]))


def test_a_flag_that_is_never_precise_enough_has_no_recall() -> None:
    trial = {"confidence": [0.9, 0.1], "at_landmark": [False, True], "moves": [False], "recognized": [False]}
    found = policies.METHODS[policies.GOAL_CLONING].samples({"landmarks": [trial]})
    assert found[evaluated.FLAG_RECALL].mean == 0


@pytest.mark.parametrize("always", [False, True])
def test_a_flag_is_not_judged_where_the_goal_held_nowhere_or_always(always: bool) -> None:
    trial = {"confidence": [0.9, 0.1], "at_landmark": [always, always]}
    assert not dict(evaluated.flagged([trial], "at_landmark"))


def test_a_recipe_is_whole_when_every_skill_is_completed() -> None:
    trials = [{"completed": [True, True]}, {"completed": [True, False]}]
    found = policies.METHODS[policies.SKILLS].samples({"recipes": trials})
    assert found[policies.RECIPE_SKILLS].mean == 0.75
    assert found[policies.RECIPE_WHOLE].mean == 0.5


def test_what_is_done_under_a_condition_is_compared_with_what_is_done_nominally() -> None:
    nominal, dim = {"completed": [True, True]}, {"completed": [True, False]}
    found = policies.METHODS[policies.SKILLS_AUGMENTED].samples(
        {"recipes": [nominal, nominal], "recipes-light-08": [dim, nominal]}
    )
    assert found[policies.RECIPE_SKILLS].mean == 1
    assert found[policies.under("light-0.8", policies.RECIPE_SKILLS)].mean == 0.75
    assert found[policies.under("light-0.8", policies.RECIPE_OF_NOMINAL)].mean == 0.75
    assert policies.under("camera-5cm", policies.RECIPE_SKILLS) not in found


def test_returns_are_shares_of_the_experts_by_the_order_of_the_start() -> None:
    trials = [
        {"episode_return": 40.0, "expert_return": 80.0, "starts": {"start/in-order": True}},
        {"episode_return": 10.0, "expert_return": 80.0, "starts": {"start/in-order": False}},
    ]
    found = policies.METHODS[policies.PPO].samples({"returns": trials})
    assert found[policies.RETURN_ALL].mean == 50 / 160
    assert found[policies.RETURN_WRONG_ORDER].mean == 0.125


def test_a_language_policy_is_judged_by_its_teachers_the_other_text_and_what_it_does_told_wordings() -> None:
    count = len(language.WORDINGS_OF_SIDES)
    left = [1.0] * (count // 2) + [0.0] * (count // 2)
    right = [0.0] * (count // 2) + [1.0] * (count // 2)
    right[-1] = 0.0
    told = {"returns": [[60.0, 5.0], [0.0, 30.0]], "successes": [[True, False, *left], [False, True, *right]]}
    blind = {"returns": [[20.0, 20.0], [25.0, 25.0]], "successes": []}
    left_teacher, right_teacher = language.TEACHERS
    trials = {
        "student-told": [told],
        "word-blind-told": [blind],
        left_teacher: [{"episode_return": 80.0}],
        right_teacher: [{"episode_return": 40.0}],
    }
    found = policies.METHODS[policies.LANGUAGE].samples(trials)
    assert found[language.TOLD_OWN].mean == 90 / 120
    assert [found[language.told_other(task)].mean for task in language.SIDES] == [15.0, 25.0]
    assert found[language.WORDINGS].mean == (count - 1) / count


def test_a_policy_that_says_when_it_is_done_is_judged_in_every_frame_before_that() -> None:
    episode = {"returns": [[60.0, 5.0], [0.0, 30.0]], "confidence": [0.1, 0.9, 0.2], "holds": [False, True, False]}
    taught = {name: [{"episode_return": 45.0}] for name in language.TEACHERS}
    found = policies.METHODS[policies.LANGUAGE_DONE].samples({"student-told": [episode], **taught})
    assert found[language.TOLD_OWN].mean == 1
    assert found[evaluated.FLAG_AUROC].mean == 1
    assert found[evaluated.FLAG_ECE].mean == pytest.approx(0.4 / 3)


def test_a_claim_that_must_be_apart_needs_its_interval_to_be() -> None:
    target = Target("a", "", (), ("b",), least=45, low_above=5)
    assert target.is_reached(50, 6)
    assert not target.is_reached(50, 5)
    assert not target.is_reached(44, 6)


@pytest.mark.long
def test_a_pipeline_runs_on_services_of_its_own(tmp_path: Path) -> None:
    steps = [
        {"name": "demos", "kind": "collect", "config": {"dataset": "demos", "task": "grid", "count": 2}},
        {
            "name": "recipes",
            "kind": "evaluate",
            "config": {"form": "returns", "task": "pendulum", "policy": "random", "episodes": 2},
        },
    ]
    ticks: list[int] = []
    first = run_pipeline(steps, tmp_path, lambda: ticks.append(os.getpid()))
    assert first is not None
    assert len(first["recipes"]) == 2
    assert ticks
    assert run_pipeline(steps, tmp_path, lambda: None) == first


@pytest.mark.long
def test_a_pipeline_begins_with_what_another_made_once_for_all(tmp_path: Path) -> None:
    demos = [step("demos", "collect", dataset="demos", task="grid", count=4)]
    source = run_once(demos, {"version": 1}, tmp_path / "shared", lambda: None)
    assert source is not None
    fit = [fit_step("fit", "segmentation", "demos", steps=1, augmentation=0)]
    assert run_pipeline(fit, tmp_path / "arm", lambda: None, source=source) == {}

    ticks: list[int] = []
    assert run_once(demos, {"version": 1}, tmp_path / "shared", lambda: ticks.append(0)) == source
    assert not ticks
    assert run_once(demos, {"version": 2}, tmp_path / "shared", lambda: ticks.append(0)) not in (source, None)
    assert ticks


def test_every_wording_that_a_language_policy_is_told_is_one_that_it_acts_on() -> None:
    known = KnownTexts([f"a yellow block to the {side} of a green block" for side in ("left", "right")])
    assert all(known.read(wording).caption for wording in language.WORDINGS_OF_SIDES)
