"""Chapter 4's experiments: their pipelines, what a student may not have seen, figures from trials, and claims."""

import shutil
from collections.abc import Iterable, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch
from experiments import criteria, registry
from experiments.chapter4 import (
    eye_without_colour,
    one_policy_report,
    puck_scenes,
    rewards_report,
    shipped_teachers,
    students,
    trained_on,
)
from experiments.chapter4.places_in_frames import project
from experiments.chapter4.tasks import TEST_TASKS
from experiments.chapter4.unseen_colour import blue_pixels, check_unseen, scanned
from experiments.robustness import reward_model
from experiments.robustness.draw import Drawn, Exploration
from experiments.robustness.worlds import open_world
from experiments.teachers import TASKS
from experiments.workbench import table
from experiments.workbench.arms import Arm
from experiments.workbench.pipelines import run_folder
from experiments.workbench.results import ArmResult, Sample
from experiments.workbench.runner import Places, arm_folder

from freerein.api.orchestrator.v1 import orchestrator_pb2
from freerein.config import parse
from freerein.data import DatasetSpec, create, dataset_path
from freerein.errors import FailedPrecondition
from freerein.field_bounds import bounds_of, check_json_bytes
from freerein.learning.actor_critic.policy_files import IN_DISTRIBUTION_FILE, load_policy
from freerein.learning.actor_critic.shared_object_encoder import FOLDER, load_object_encoder, save_object_encoder
from freerein.learning.augmentation import resized_crops
from freerein.model_store import CLONE_MODELS, ModelStore
from freerein.types.common import ActionSpec, ModelRef, Trajectory
from freerein_imitation.methods.language.config import LanguageConfig
from freerein_imitation.methods.language.goal_text_dataset import random_shift
from freerein_imitation.methods.language.texts import tagged_texts
from freerein_imitation.model.known_texts import KnownTexts
from freerein_orchestrator.kinds import KINDS
from freerein_orchestrator.kinds.ppo_config import PPORunConfig
from freerein_reward.model import load_reward_model
from freerein_sim.worlds.tasks import tasks

PIPELINES = ("table_4_2", "fig_4_4", "fig_4_6")


@pytest.mark.parametrize("name", PIPELINES)
def test_the_orchestrator_takes_the_pipeline_of_every_arm_and_evaluates_on_seeds_of_no_training(name: str) -> None:
    experiment: Any = registry.load(name)
    longest = bounds_of(orchestrator_pb2.StartRunRequest.DESCRIPTOR.fields_by_name["config"])
    for arm in experiment.arms:
        steps = experiment.config(arm)["steps"]
        KINDS["pipeline"].parse({"steps": steps})
        check_json_bytes({"steps": steps}, longest, "config")
        if arm.method == students.IN_SCENES:
            steps = [*students.evaluations_in(students.SCENES[0])]
        held_out = {step["config"]["seed"] for step in steps if step["kind"] == "evaluate"}
        assert held_out
        assert arm.seed not in held_out


def test_students_learn_from_fifty_rollouts_a_task_of_tasks_without_blue() -> None:
    assert len({*TASKS, *TEST_TASKS}) == 36
    assert all(name in tasks() for name in TEST_TASKS)
    assert not any("blue" in task for task in TASKS)
    for method in (students.OURS, students.DISSERTATION):
        config = students.distil(method, "text", 0)["config"]
        assert (config["dagger_iterations"] + 1) * config["rollouts"] <= 50
        assert config["teachers"] == list(TASKS)
        LanguageConfig.from_mapping(config["config"])


def test_an_arm_that_fits_again_has_the_fit_of_ours_and_says_when_it_is_done_where_it_is_asked_to() -> None:
    ours, silent, says = (
        students.distil(students.OURS, "text", 1)["config"]["config"],
        students.refit(1)["config"]["config"],
        students.refit(1, says_when_done=True)["config"]["config"],
    )
    assert silent == {**ours, "method": "language"}
    assert says == {**silent, "reached_weight": 0.3}


def test_a_student_of_the_dissertation_takes_the_unknown_word_and_no_text_that_it_is_told_says_blue() -> None:
    known = KnownTexts([tasks()[task].goal_text for task in TASKS], any_object=True)
    told = [step["config"]["policy"]["goal_text"] for step in students.renamed_evaluations()]
    assert len(told) == 36
    assert all(students.UNKNOWN_WORD in text and "blue" not in text and known.read(text).caption for text in told)


def test_no_word_that_trains_the_reader_of_texts_is_blue() -> None:
    rng = np.random.default_rng(0)
    drawn = {word for _ in range(2000) for word, _ in tagged_texts.draw_tagged_text(rng)}
    assert "red" in drawn
    assert "blue" not in drawn


def shown(task: str) -> npt.NDArray[np.uint8]:
    """Returns the first frame of an episode, uint8 (64, 64, 3)."""
    with closing(open_world(task)) as world:
        world.reset(np.random.default_rng(0))
        return world.render("front", height=64, width=64).copy()


def record(root: Path, *names: str) -> None:
    """Records a frame of each task, with its goal text."""
    action = ActionSpec(3, 0, ("dy", "dz", "gripper"), "m", (1.0, 1.0, 1.0))
    with create(root, DatasetSpec(25, {"front": (64, 64, 3)}, action, "blocks")) as writer:
        for name in names:
            done = np.zeros((1, 3), np.float32)
            writer.append(Trajectory({"front": shown(name)[None]}, done, goal_text=tasks()[name].goal_text))


def test_a_scan_of_all_that_was_learned_from_finds_a_colour_that_is_shown_or_named(tmp_path: Path) -> None:
    record(tmp_path / "train", *TASKS)
    check_unseen(tmp_path / "train", tmp_path)
    assert scanned(tmp_path) == {"timesteps": 18, "pixels": 0, "texts": 0}
    assert all(blue_pixels(shown(task)) > 10 for task in TEST_TASKS)

    record(tmp_path / "test", TASKS[0], TEST_TASKS[0])
    folder = tmp_path / "arm"
    folder.mkdir()
    for _ in range(2):  # what was found stays found
        with pytest.raises(FailedPrecondition, match="1 texts"):
            check_unseen(tmp_path / "test", folder)
        shutil.rmtree(tmp_path / "test", ignore_errors=True)


def test_no_crop_or_shift_of_what_is_learned_from_is_blue() -> None:
    frames = torch.from_numpy(np.stack([shown(task) for task in TASKS] * 10))
    drawn = torch.Generator().manual_seed(0)
    assert blue_pixels(resized_crops(random_shift(frames, most=0.25, generator=drawn), generator=drawn).numpy()) == 0


def test_an_eye_without_the_colour_is_fitted_to_images_without_it_and_leaves_the_students_own_as_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(eye_without_colour, "_PIECE", 8)
    drawn = eye_without_colour.ColourlessExploration(3, 7).draw()
    assert len(drawn.seen["lengths"]) == 3
    assert blue_pixels(drawn.seen["frames"]) == 0
    assert blue_pixels(Exploration(8, 7).draw().seen["frames"])

    student = dataset_path(tmp_path / "student" / "data", students.DATASET)
    record(student, TASKS[0])
    (teacher,) = (CLONE_MODELS / "orchestrator" / TASKS[0]).glob("*/policy.json")
    policy = load_policy(teacher.parent, device="cpu")
    save_object_encoder(policy, phrases=reward_model.PHRASES, folder=student / FOLDER)
    store = ModelStore(CLONE_MODELS / "reward")
    fitted = load_reward_model(store.folder(ModelRef("default", store.active_version("default"))), "cpu")
    torch.nn.init.zeros_(next(fitted.network.image.parameters()))
    monkeypatch.setattr(reward_model, "fit_model", lambda *_args, **_more: fitted)
    made = eye_without_colour.with_eye(tmp_path / "student", tmp_path / "arm", tmp_path, lambda: None, seed=0)
    assert made == tmp_path / "arm"
    own, other = (
        load_object_encoder(root / FOLDER)[0] for root in (student, dataset_path(made / "data", students.DATASET))
    )
    assert next(own.eye.objects.parameters()).any()
    assert not next(other.eye.objects.parameters()).any()
    assert torch.equal(own.eye.hand_eye, other.eye.hand_eye)


def test_gray_walls_and_other_colours_are_not_blue() -> None:
    others = [(120, 135, 147), (219, 23, 18), (31, 168, 41), (250, 204, 15), (0, 0, 20)]
    assert blue_pixels(np.array(others, np.uint8)) == 0
    assert blue_pixels(np.array([(26, 77, 235)], np.uint8)) == 1


def student(method: str, how: str, seed: int, share: float) -> ArmResult:
    """Returns the result of a student that earns a share of the expert's 80 points."""
    options = {"conditioning": how} if how else {}
    trials = episodes(students.evaluations("random"), share)
    return result(Arm("blocks", method, options, seed), dict(students.samples(trials)), dict(students.figures(trials)))


def student_in_scenes(seed: int, share: float) -> ArmResult:
    """Returns the result of a student that earns a share of the expert's points in other scenes, in the dark less."""
    trials = dict[str, list[dict[str, Any]]]()
    for scene in students.SCENES:
        trials |= episodes(students.evaluations_in(scene), share * (0.6 if scene == "light-0.6" else 1), count=2)
    arm = Arm("blocks", students.IN_SCENES, {"conditioning": "text"}, seed)
    return result(arm, dict(students.samples_in_scenes(trials)))


def student_that_says(seed: int, calibrated: float) -> ArmResult:
    """Returns the result of a student whose confidence is right in a share of the trials."""
    trial = {"returns": [[70, 0], [0, 60]], "holds": [True, False]}
    said = [[1.0, 0.0] if place < 20 * calibrated else [0.4, 0.6] for place in range(20)]
    trials = {step["name"]: [{**trial, "confidence": each} for each in said] for step in students.done_evaluations()}
    return result(Arm("blocks", students.DONE, {"conditioning": "text"}, seed), dict(students.done_samples(trials)))


def episodes(steps: Iterable[Mapping[str, Any]], share: float, *, count: int = 4) -> dict[str, list[dict[str, Any]]]:
    return {
        step["name"]: [
            {"episode_return": 80 * share + place, "expert_return": 80.0, "starts": begins(step, place % 2 == 0)}
            for place in range(count)
        ]
        for step in steps
    }


def begins(step: Mapping[str, Any], holds: bool) -> dict[str, bool]:
    return {"start/from-left" if "on-top" in step["config"]["task"] else "start/in-order": holds}


def result(arm: Arm, samples: Mapping[str, Sample], figures: Mapping[str, float] = {}) -> ArmResult:
    identity = {"name": arm.name, "world": arm.world, "method": arm.method, "options": arm.options, "seed": arm.seed}
    made = {"config": {}, "world_version": "blocks-v1", "machine": {}, "command": "python"}
    return ArmResult(**identity, **made, figures=figures, samples=samples, minutes=1.0, cpu_minutes=1.0)


def test_a_claim_on_students_needs_three_seeds_and_a_difference_that_is_above_chance_in_the_same_episodes() -> None:
    shares = {("ours", "text"): 0.7, ("ours", "code"): 0.5, ("ours", "none"): 0.3, ("dissertation", "text"): 0.25}
    results = [student(*row, seed, share) for row, share in shares.items() for seed in range(3)]
    in_scenes = [student_in_scenes(seed, 0.7) for seed in range(3)]
    made = one_policy_report.table([*results, *in_scenes, student("random", "", 0, 0.0)])
    found = {claim.claim: claim for claim in made.claims}
    seen = found["language_train_seen"]
    assert seen.value == pytest.approx(100 * (56 + 1.5) / 80, abs=0.01)
    assert (seen.met, seen.seeds, seen.trials) == (True, 3, 4)  # a start, of all tasks, is a trial
    assert seen.baseline == pytest.approx(100 * (20 + 1.5) / 80, abs=0.01)
    assert found["language_train_seen_points"].dissertation == 29.89
    assert found["conditioning_order"].value == pytest.approx(20, abs=0.01)
    assert all(found[f"conditioning_order{starts}"].met for starts in ("", "_unseen"))
    light = 100 * (48 * 0.7 + 0.5) / (80 * 0.7 + 0.5)  # of the first two episodes
    assert (found["policy_light"].value, found["policy_light"].met) == (pytest.approx(light, abs=0.01), False)
    assert "dissertation" in table.markdown(made)

    renamed = {each.claim for each in one_policy_report.table([*results, student_that_is_told_less()]).claims}
    assert "blue_renamed_text_test_seen" in renamed
    assert "blue_renamed_text_train_seen" not in renamed

    fewer = {claim.claim: claim for claim in one_policy_report.table(results[1:]).claims}
    assert not fewer["language_train_seen"].met
    assert not fewer["conditioning_order"].met
    alike = [student("ours", how, seed, 0.5) for how in ("text", "code", "none") for seed in range(3)]
    assert not {claim.claim: claim for claim in one_policy_report.table(alike).claims}["conditioning_order"].met


def student_that_is_told_less() -> ArmResult:
    """Returns the result of a student that was evaluated in test tasks alone."""
    trials = episodes(students.renamed_evaluations(), 0.2)
    return result(Arm("blocks", students.RENAMED, {"conditioning": "text"}), dict(students.samples(trials)))


@pytest.mark.parametrize(("calibrated", "seeds", "met"), [(1.0, 3, True), (1.0, 2, False), (0.9, 3, False)])
def test_a_student_says_when_it_is_done_where_three_seeds_are_right_and_calibrated_in_both_sets(
    calibrated: float, seeds: int, met: bool
) -> None:
    said = [student_that_says(seed, calibrated) for seed in range(seeds)]
    made = one_policy_report.table([student("ours", "text", 0, 0.7), *said])
    found = {claim.claim: claim for claim in made.claims}
    assert found["language_done"].met is met
    assert found["language_done"].trials == 20
    assert said[0].samples["test.points"].mean == 65
    assert "says when its goal is reached" in table.markdown(made)


@pytest.mark.parametrize(("ours", "oracle", "met"), [(78.0, 80.0, True), (60.0, 80.0, False), (30.0, 30.0, False)])
def test_a_ratio_counts_where_the_oracles_policy_comes_near_the_expert(ours: float, oracle: float, met: bool) -> None:
    results = []
    for reward, points in ((trained_on.LEARNED, ours), (trained_on.ORACLE, oracle)):
        episode = {"episode_return": points, "expert_return": 80.0, "baseline_return": 5.0}
        samples = dict(trained_on.samples({"returns": [episode] * 4}))
        results += [result(Arm(trained_on.STACK, reward, {"tuning": "ours"}, seed), samples) for seed in range(5)]
    made = rewards_report.manipulation(results)
    (ratio,) = (claim for claim in made.claims if claim.claim == "stack_ratio")
    assert (ratio.value, ratio.met) == (pytest.approx(ours / oracle), met)
    assert f"| {ours:.1f} | 5.0 |" in table.markdown(made)


def test_a_pendulum_has_no_expert_to_share_with() -> None:
    samples = dict(trained_on.samples({"returns": [{"episode_return": 200.0, "baseline_return": 30.0}]}))
    assert trained_on.RETURN not in samples
    made = rewards_report.balance([result(Arm("pendulum", "alive"), samples)])
    assert made.claims[0].value == 200.0


@pytest.mark.parametrize("tuning", ["ours", "dissertation"])
def test_a_training_and_the_images_of_its_reward_and_eye_are_within_200_000_ticks(tuning: str) -> None:
    arm = Arm(trained_on.PUSH, trained_on.LEARNED, {"tuning": tuning})
    by_name = {step["name"]: step["config"] for step in (*trained_on.shared_steps(arm), *trained_on.steps(arm))}
    config = parse(PPORunConfig, by_name["ppo"])
    images = by_name["images"]["count"] * tasks()["push.scatter"].spec.max_episode_steps
    explored = config.explorations * 8 * config.num_envs * config.action_repeat if config.eye_model else 0
    total = images + explored + config.iterations * config.rollout_size * config.action_repeat
    assert 198_000 < total <= 200_000


def test_a_classifier_of_success_is_judged_on_successes_that_it_has_not_seen(tmp_path: Path) -> None:
    bright, dark = np.full((32, 32, 3), 230, np.uint8), np.full((32, 32, 3), 20, np.uint8)
    action = ActionSpec(1, 0, ("x",), "m", (1.0,))
    for name, last in (("won", bright), ("won-held-out", dark)):
        with create(dataset_path(tmp_path, name), DatasetSpec(25, {"front": (32, 32, 3)}, action, "blocks")) as writer:
            for _ in range(4):
                frames = np.stack([dark, dark, dark, dark, last])
                writer.append(Trajectory({"front": frames}, np.zeros((5, 1), np.float32)))
    told = dict(trained_on.classifier_samples(tmp_path, seed=0))
    assert {name: sample.mean for name, sample in told.items()} == {"told-success": 0, "told-failure": 1}
    arm = result(Arm(trained_on.STACK, trained_on.VICE, {"tuning": "ours"}), _returns() | told)
    assert "| blocks.yellow-on-top-of-red | 1 | 0.0 [0.0, 0.0] | 100.0 [100.0, 100.0] |" in table.markdown(
        rewards_report.manipulation([arm])
    )


def _returns() -> dict[str, Sample]:
    episode = {"episode_return": 40.0, "expert_return": 80.0, "baseline_return": 5.0}
    return dict(trained_on.samples({"returns": [episode] * 4}))


def test_teachers_whose_arms_are_done_ship_by_the_names_of_their_tasks_and_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    experiment, work = registry.load("teachers"), tmp_path / "work"
    (made,) = (CLONE_MODELS / "orchestrator" / "yellow-left-of-green").glob("*/policy.json")
    arm = experiment.arms[2]
    folder = arm_folder("teachers", experiment, arm, Places(work=work))
    artifacts = run_folder(folder) / "parts" / "ppo" / "artifacts"
    shutil.copytree(made.parent, artifacts)
    (artifacts / IN_DISTRIBUTION_FILE).write_bytes(b"")
    (artifacts / "policy.mp4").write_bytes(b"")
    monkeypatch.setenv("FREEREIN_SHIPPED_DIR", str(tmp_path / "shipped"))
    assert shipped_teachers.shipped_teachers() == ()
    (ref,) = shipped_teachers.publish(work)
    assert list(shipped_teachers.publish(work)) == [ref]
    assert ref.name == arm.world
    store = ModelStore(tmp_path / "shipped" / "orchestrator")
    assert sorted(path.name for path in store.folder(ref).iterdir()) == [
        "in_distribution.safetensors",
        "manifest.json",
        "policy.json",
        "policy.safetensors",
    ]
    (teacher,) = shipped_teachers.shipped_teachers()
    assert teacher.task == arm.world
    assert len(teacher.sha256) == 64


def test_a_blocks_centre_is_projected_to_where_it_is_seen() -> None:
    task = "blocks.red-left-of-green"
    with closing(open_world(task)) as world:
        world.reset(np.random.default_rng(0))
        frame, state = world.render("front", height=64, width=64).astype(int), world.truth().state
    names = tasks()[task].spec.state_names
    is_red = (frame[..., 0] > 100) & (frame[..., 1] < 60)
    rows, columns = np.nonzero(is_red)
    centre = project(np.array([state[names.index(f"red.{axis}")] for axis in "xyz"]), size=64)
    assert centre == pytest.approx([columns.mean() + 0.5, rows.mean() + 0.5], abs=1.5)


def scene(**places: tuple[float, float, float]) -> npt.NDArray[np.float64]:
    """Returns a true state, float64 (S,), of `push.scatter` with things at places, by names such as `red_puck`."""
    names = tasks()["push.scatter"].spec.state_names
    state = np.full(len(names), -3.0)
    for thing, place in places.items():
        for axis, value in zip("xyz", place, strict=True):
            state[names.index(f"{thing.replace('_', '-')}.{axis}")] = value
    return state


def test_goals_about_pucks_are_asked_where_a_colour_names_one_thing_and_judged_by_true_places() -> None:
    left, right, behind = (0.0, -0.1, 0.0125), (0.0, 0.1, 0.0125), (-0.2, 0.1, 0.0125)
    states = np.stack(
        [
            scene(red_puck=left, green_puck=right, blue_block=behind),
            scene(red_puck=left, red_block=right, green_puck=behind),
            scene(red_puck=left, tray=(0.0, -0.1, 0.017)),
        ]
    )
    red, green, blue, cyan = (puck_scenes.NOUNS.index(each) for each in ("red", "green", "blue", "cyan"))
    found = {(each.criterion, each.nouns): each for each in puck_scenes.asked(states)}
    assert found["left_of", (red, green)].holds.tolist() == [True, False, False]
    assert found["left_of", (red, green)].counts.tolist() == [True, False, False]  # red names two things, then nothing
    assert found["in_front_of", (green, blue)].holds[0]
    assert found["close_to", (red, green)].counts[0]
    assert not found["close_to", (red, green)].holds[0]
    assert found["inside_of", (red, cyan)].holds.tolist() == [False, False, True]
    assert not found["inside_of", (red, green)].counts.any()  # no tray
    assert not found["in_front_of", (red, green)].counts.any()  # neither is in front
    assert found["in_between", (red, green, blue)].counts[0]
    assert not found["in_between", (green, red, blue)].counts[0]  # green and blue are one behind the other


def test_a_criterion_that_is_always_told_right_has_1_and_one_that_is_never_rewarded_one_half() -> None:
    rng = np.random.default_rng(0)
    things = ("red_puck", "green_puck", "blue_block", "tray")
    states = np.stack(
        [
            scene(**{each: (*rng.uniform(-0.1, 0.1, 2), rng.choice([0.0125, 0.05])) for each in things})
            for _ in range(60)
        ]
    )
    scenes = Drawn({"lengths": np.full(30, 2)}, {"states": states})
    right = dict(criteria._samples(scenes, lambda goal: goal.holds))
    never = dict(criteria._samples(scenes, lambda goal: np.zeros(len(goal.holds), np.bool_)))
    assert len(right) == 9
    assert all(each.mean == pytest.approx(1) for each in right.values())
    assert all(each.mean == pytest.approx(0.5, abs=1e-6) for each in never.values())
    results = [result(Arm("push.scatter", criteria.MODEL, seed=seed), right) for seed in range(3)]
    made = criteria.EXPERIMENT.table([*results, result(Arm("push.scatter", criteria.RULE), never)])
    claims = {claim.claim: claim for claim in made.claims}
    assert claims["criteria"].met
    assert claims["rule_left_of"].value == pytest.approx(50, abs=0.01)
    table.markdown(made)
