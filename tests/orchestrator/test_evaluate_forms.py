"""The forms of runs of kind `evaluate`, with real services and shipped models."""

import json
from collections.abc import Callable
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import safetensors.numpy
import torch
from tests.engine import needs_engine

from freerein.clients import Channel, SimClient, SyncClient
from freerein.clients.tasks import find_task
from freerein.data import Dataset, dataset_path, labels
from freerein.data.labels import LabelsWriter
from freerein.errors import FailedPrecondition, InvalidInput
from freerein.learning import weights
from freerein.learning.model_files import save_model
from freerein.model_store import ModelStore
from freerein.types.common import ActionSpec, Camera
from freerein.types.sim import CreateSessionRequest, Predicate, Task
from freerein_orchestrator.envs.episodes import replay, run_episodes
from freerein_orchestrator.envs.random_policies import exploration_policy
from freerein_orchestrator.envs.truth import check_predicates
from freerein_orchestrator.kinds import KINDS
from freerein_orchestrator.kinds.evaluate.demonstration import (
    FAILURES,
    check_completed,
    efficiency,
    stopped_at,
    times_in_order,
    times_left,
)
from freerein_orchestrator.kinds.evaluate.form import enlarged
from freerein_orchestrator.kinds.evaluate.landmarks import pursuit_of, reached_by_truth
from freerein_orchestrator.kinds.evaluate.recipes import (
    attempt_bounds,
    known_skills,
    places_in_recipe,
    random_behaviour,
)
from freerein_orchestrator.kinds.evaluate.sentences import confusion_matrix, told_is_done
from freerein_orchestrator.kinds.policy_video import VIDEO
from freerein_reward.model import DualEncoder, DualEncoderSpec

EXPLORATION = {"landmarks": 2, "spacing": 3, "steps_per_landmark": 4, "episodes": 4, "num_envs": 2}
LANDMARKS = {"form": "landmarks", "task": "blocks", "policy": {"model": "default"}, **EXPLORATION}
RECIPES = {"form": "recipes", "task": "blocks", "policy": {"model": "skills"}, "episodes": 2, "num_envs": 1}
ROUNDS = {"episodes": 2, "num_envs": 1}
DEMONSTRATIONS = {"form": "demonstrations", "task": "blocks", "policy": "random"}
SHORT = {"skills_per_recipe": 2, "episode_steps": 80}
RELATIONS = {"form": "relations", "task": "blocks.scatter", "episodes": 4, "num_envs": 2}
TEXT = "a yellow block to the {} of a green block"
TINY = {"steps": 2, "batch_size": 2, "features": 8, "hidden_size": 8}
SEGMENTATION = {"form": "segmentation", "task": "grid", "model": "grid", "min_skills": 2, "episodes": 4, "num_envs": 2}


@pytest.fixture(scope="module")
def services(start_module_service: Callable[..., Any], wait_until: Callable[..., float]) -> dict[str, str]:
    """Addresses of sim, imitation and reward, by variable."""
    started = {
        "SIM": start_module_service("freerein_sim", FREEREIN_SIM_WORKERS="1"),
        "IMITATION": start_module_service("freerein_imitation"),
        "REWARD": start_module_service("freerein_reward"),
    }
    wait_until(started["SIM"].is_ready, 300)
    publish_two_phrases(started["REWARD"].data_dir)
    return {f"FREEREIN_{name}_ADDRESS": service.address for name, service in started.items()}


def publish_two_phrases(data_dir: Path) -> None:
    """Puts an untrained reward model of two phrases, `two`, into the store of the reward service."""
    spec = DualEncoderSpec(
        cameras=("front",), phrases=("a red block", "a green block"), vocabulary=("a", "red", "green", "block")
    )
    network, folder = DualEncoder(spec), data_dir / "two"
    weights.initialise(network, generator=torch.Generator().manual_seed(0))
    save_model(network, folder, card={"method": "relation_captions"})
    store = ModelStore(data_dir / "models" / "reward")
    store.activate(store.publish("two", folder))


@pytest.fixture
def evaluation(new_run: Callable[..., Any], tmp_path: Path, services: dict[str, str]) -> Callable[..., Any]:
    """A function that makes a run of a configuration."""
    return lambda config, **environ: new_run(tmp_path, "evaluate", config, **{**services, **environ})


def finish_after_a_stop(run: Any) -> Any:
    """Stops a run after its first round, and finishes it; returns its result."""
    assert not run.do(stop=(run.folder / "checkpoints" / "rounds.jsonl").exists)
    assert 0 < len(run.rows) < run.config.episodes
    assert run.do()
    return run.artifact("result.json")


def frames_of(run: Any) -> dict[str, Any]:
    frames = safetensors.numpy.load_file(run.folder / "artifacts" / "frames.safetensors")
    assert {each.dtype for each in frames.values()} == {np.dtype(np.uint8)}
    return frames


def check_figures(result: dict[str, Any], *names: str) -> None:
    """Checks that a result has these figures, each within its interval and beside a baseline."""
    for name in names:
        figure = result["figures"][name]
        assert 0 <= figure["low"] <= figure["value"] <= figure["high"] <= 1
        assert 0 <= figure["baseline"] <= 1


@pytest.mark.e2e
def test_episodes_of_equal_sessions_begin_in_equal_states_whatever_the_policy_draws(services: dict[str, str]) -> None:
    request = CreateSessionRequest("blocks", num_envs=2, seed=5, privileged=True)
    with SyncClient(SimClient(Channel(services["FREEREIN_SIM_ADDRESS"]))) as sim:
        policies = [exploration_policy(find_task(sim, "blocks").action, stream=stream) for stream in (0, 0, 1)]
        first, again, other = (
            run_episodes(sim, request, policy, lambda: None, cameras=("front",), max_steps=4)[1] for policy in policies
        )
        seeing = replace(policies[0], cameras=("front",))
        unrecorded = run_episodes(sim, request, seeing, lambda: None, max_steps=4)[1]
        replayed = replay(sim, request, first.actions, lambda: None, camera="front", times=[0, 2, 4])
    assert unrecorded.frames == {}
    assert first.frames["front"].shape == (5, 64, 64, 3)
    np.testing.assert_array_equal(first.states, again.states)
    np.testing.assert_array_equal(first.frames["front"], again.frames["front"])
    np.testing.assert_array_equal(first.frames["front"][[0, 2, 4]], replayed)
    np.testing.assert_array_equal(first.states[0], other.states[0])
    assert not np.array_equal(first.actions, other.actions)


@pytest.mark.parametrize(
    ("camera", "rendered"), [((64, 64), (256, 256)), ((240, 320), (240, 320)), ((480, 640), (240, 320))]
)
def test_pictures_are_as_large_as_worlds_render_in_the_proportions_of_the_camera(
    camera: tuple[int, int], rendered: tuple[int, int]
) -> None:
    asked: list[tuple[int, int]] = []

    def render(*size: int) -> Any:
        asked.append((size[0], size[1]))
        if size == rendered:
            raise InvalidInput("Frames are 1 to 33 pixels high and wide.")
        return np.zeros((1, *size, 3), np.uint8)

    assert enlarged(Camera("front", *camera, 3), (33, 30), render).shape == (1, 33, 30, 3)
    assert asked == [rendered, (33, 30)]


@pytest.mark.e2e
def test_landmarks_are_followed_from_the_starts_of_the_rollouts_that_they_come_from(
    evaluation: Callable[..., Any],
) -> None:
    run = evaluation(LANDMARKS)
    result = finish_after_a_stop(run)
    check_figures(result, "landmarks_reached")
    assert result["model"]["version"]
    assert result["counts"] == {"episodes": 4, "landmarks": 8}
    assert {"landmarks_recognized", "visited.at_landmark", "visited.goal_ece"} <= set(result["figures"])
    frames, pursuits = frames_of(run), run.artifact("frames.json")
    assert frames["goals"].shape == (2, 256, 256, 3)
    assert len(frames["ends"]) == len(pursuits)
    assert (run.folder / "artifacts" / VIDEO).is_file()


@pytest.mark.e2e
def test_a_reward_model_that_does_not_know_the_words_of_the_captions_is_refused(
    evaluation: Callable[..., Any],
) -> None:
    with pytest.raises(FailedPrecondition, match="does not know yellow"):
        evaluation(RELATIONS | {"model": "two"}).do()


@pytest.mark.e2e
def test_random_actions_as_the_policy_say_nothing_of_landmarks_and_are_judged_by_truth(
    evaluation: Callable[..., Any],
) -> None:
    run = evaluation(LANDMARKS | {"policy": "random"})
    assert run.do()
    result = run.artifact("result.json")
    check_figures(result, "landmarks_reached")
    assert "landmarks_recognized" not in result["figures"]
    assert (run.folder / "artifacts" / VIDEO).is_file()
    with pytest.raises(InvalidInput, match="steps_per_landmark"):
        evaluation(LANDMARKS | {"policy": "random", "steps_per_landmark": 0}).do()
    late = evaluation(LANDMARKS | {"policy": "random", "landmarks": 256, "spacing": 10})
    with pytest.raises(InvalidInput, match="the steps of an episode; got 2560"):
        late.do()
    assert not late.rows


@pytest.mark.e2e
def test_the_expert_completes_its_recipes_and_random_actions_do_not(evaluation: Callable[..., Any]) -> None:
    run = evaluation(RECIPES | SHORT | {"policy": "expert"})
    result = finish_after_a_stop(run)
    check_figures(result, "skills_completed", "skills_lifted", "whole")
    assert result["figures"]["skills_completed"]["value"] > 0.7
    rounds = (run.folder / "checkpoints" / "rounds.jsonl").read_text().splitlines()
    completed = [trial["completed"] for each in rounds for trial in json.loads(each)["trials"]]
    assert result["figures"]["whole"]["value"] == np.mean([all(each) for each in completed])
    assert result["figures"]["skills_completed"]["baseline"] < 0.3
    assert result["counts"] == {"episodes": 2, "skills": 4}
    assert (run.folder / "artifacts" / VIDEO).is_file()


@pytest.mark.e2e
@pytest.mark.parametrize(
    ("asked", "skills"),
    [
        ({"task": "grid"}, 5),
        pytest.param({"task": "dial"}, 5, marks=pytest.mark.long),  # that each world's expert does what it says is
        pytest.param({"task": "bins"}, 4, marks=pytest.mark.long),  # a check of the conformance suite
        pytest.param({"task": "tabletop"}, 2, marks=pytest.mark.long),
        pytest.param({"task": "blocks", "conditions": ["blocks-2"], **SHORT}, 2, marks=pytest.mark.long),
    ],
    ids=["grid", "dial", "bins", "tabletop", "blocks-2"],
)
def test_the_expert_completes_recipes_as_the_world_draws_and_displays_them(
    evaluation: Callable[..., Any], asked: dict[str, Any], skills: int
) -> None:
    run = evaluation(RECIPES | {"policy": "expert", "num_envs": 2, **asked})
    assert run.do()
    result = run.artifact("result.json")
    assert result["figures"]["skills_completed"]["value"] == result["figures"]["whole"]["value"] == 1
    assert result["figures"]["whole"]["baseline"] == 0
    assert result["counts"] == {"episodes": 2, "skills": 2 * skills}


@pytest.mark.e2e
def test_a_served_model_executes_recipes(evaluation: Callable[..., Any]) -> None:
    run = evaluation(RECIPES | {"num_envs": 2, "episode_steps": 40})
    assert run.do()
    check_figures(run.artifact("result.json"), "skills_completed", "skills_lifted", "whole")
    assert run.artifact("result.json")["model"]["name"] == "skills"


@pytest.mark.e2e
def test_a_reward_model_chooses_among_the_captions_of_every_visible_pair(evaluation: Callable[..., Any]) -> None:
    run, answers = evaluation(RELATIONS | {"task": "blocks"}), 12
    result = finish_after_a_stop(run)
    check_figures(result, "accuracy", "balanced_accuracy")
    assert result["counts"] == {"scenes": 8, "answers": 8 * answers}
    rounds = (run.folder / "checkpoints" / "rounds.jsonl").read_text().splitlines()
    scenes = [scene for each in rounds for trial in json.loads(each)["trials"] for scene in trial["scenes"]]
    truths: dict[str, list[int]] = {}
    for answer in chain.from_iterable(scenes):
        truths.setdefault(answer["group"], []).append(answer["truth"])
    most = [max(map(truth.count, truth)) for truth in truths.values()]
    assert result["figures"]["accuracy"]["baseline"] == pytest.approx(sum(most) / (8 * answers))
    assert result["model"]["version"]
    pictures, frames = run.artifact("frames.json"), frames_of(run)
    assert {picture["frame"] for picture in pictures} == set(frames)
    assert all(len(picture["texts"]) == len(picture["similarities"]) == 5 for picture in pictures)
    assert all(-1.01 <= each <= 1.01 for picture in pictures for each in picture["similarities"])


@pytest.mark.long  # a fit of a language policy, and episodes of MuJoCo; below, what its result consists of
@pytest.mark.e2e
def test_a_student_of_a_trained_policy_is_told_every_goal_text_in_every_task_and_compared_with_one_constant_text(
    new_run: Callable[..., Any], start_service: Callable[..., Any], services: dict[str, str], tmp_path: Path
) -> None:
    tasks, texts = ([name.format(side) for side in ("left", "right")] for name in ("blocks.yellow-{}-of-green", TEXT))
    small = {"iterations": 1, "num_envs": 2, "num_steps": 4, "batch_size": 4, "epochs": 1, "hidden_size": 8}
    teach = {"task": tasks[0], "reward": "oracle", "encoder": "spatial", "feature_size": 8, **small}
    words = {"steps": 2, "batch_size": 2, "features": 8, "text_features": 4, "hidden_size": 8, "log_every": 2}
    distill = {"teachers": ["teacher", "yellow-right-of-green"], "rollouts": 2, "num_envs": 2, "config": words}
    told = {"run": "student", "goal_text": texts[0]}
    sentences = {"form": "sentences", "task": tasks[0], "other_tasks": tasks[1:], "policy": {"run": "student"}}
    steps = [
        {"name": "teacher", "kind": "ppo", "config": teach},
        {"name": "student", "kind": "distill", "config": distill},
        {"name": "exam", "kind": "evaluate", "config": {"task": tasks[0], "policy": told, "episodes": 1}},
        {"name": "told", "kind": "evaluate", "config": sentences | {"episodes": 2, "num_envs": 2}},
    ]
    imitation = start_service("freerein_imitation", tmp_path, FREEREIN_SHIPPED_DIR="none").address
    run = new_run(tmp_path, "pipeline", {"steps": steps}, **services | {"FREEREIN_IMITATION_ADDRESS": imitation})
    run.check()
    assert run.do()
    assert run.rows[-1]["step"] == 1 + 2 * 2 + 2 + 1 + 2
    assert all((run.folder / "artifacts" / f"{step}.{VIDEO}").is_file() for step in ("teacher", "exam", "told"))
    exam = run.artifact("exam.result.json")
    assert (exam["goal_text"], exam["model"]["version"]) == (texts[0], run.model.version)
    (learned, _) = run.artifact("student.dataset.json")["teachers"]
    assert learned["sha256"] == run.artifact("teacher.policy.json")["sha256"]
    result = run.artifact("told.result.json")
    assert (result["tasks"], result["goal_texts"], result["counts"]["episodes"]) == (tasks, texts, 2 * 2 * 2)
    returns = {(each["task"], each["goal_text"]): each["return_mean"]["value"] for each in result["told"]}
    own = np.mean([returns[pair] for pair in zip(tasks, texts, strict=True)])
    constant = {text: np.mean([returns[task, text] for task in tasks]) for text in texts}
    figures = result["figures"]
    assert figures["own_text_return"]["value"] == pytest.approx(own)
    assert figures["own_text_return"]["baseline"] == pytest.approx(constant[result["word_blind_text"]])
    assert constant[result["word_blind_text"]] == max(constant.values())
    assert figures["gain_by_words"]["value"] == pytest.approx(own - max(constant.values()))
    assert figures["word_blind"]["value"] == pytest.approx(max(constant.values()))
    assert [row["goal_text"] for row in result["confusion"]] == texts
    for row in result["confusion"]:
        assert list(row["done"]) == tasks
        assert row["none"] + sum(row["done"].values()) == pytest.approx(1)  # starts are equal, goals exclude each other


@pytest.mark.e2e
def test_demonstrations_are_collected_fitted_labelled_and_the_labels_measured_on_fresh_ones(
    new_run: Callable[..., Any], start_service: Callable[..., Any], services: dict[str, str], tmp_path: Path
) -> None:
    demos = {"task": "grid", "dataset": "demos", "count": 6, "max_skills": 2}
    fit = {"service": "segmentation", "dataset": "demos", "model_name": "grid", "config": TINY}
    steps = [
        {"name": "demos", "kind": "collect", "config": demos},
        {"name": "fit", "kind": "fit", "config": fit},
        {"name": "label", "kind": "label", "config": {"dataset": "demos", "model": "grid", "smoothing": 1}},
    ]
    segmentation = start_service("freerein_segmentation", tmp_path)
    addresses = {**services, "FREEREIN_SEGMENTATION_ADDRESS": segmentation.address}
    pipeline = new_run(tmp_path, "pipeline", {"steps": steps}, **addresses)
    marked = pipeline.folder / "parts" / "label" / "checkpoints" / "labelled.json"
    assert not pipeline.do(stop=marked.exists)
    root = dataset_path(tmp_path, "demos")
    assert not (root / "labels" / "info.json").exists()
    with LabelsWriter(root, name="another") as writer:
        writer.save(0, np.zeros(999, np.int64))
    assert pipeline.do()
    assert pipeline.artifact("label.labels.json")["model"] == vars(labels.info(root).model)
    found = labels.all_labels(root, Dataset(root).lengths)
    assert len(found) == 6
    assert new_run(tmp_path, "label", steps[2]["config"] | {"earlier": 2}, **addresses).do()
    for before, after in zip(found, labels.all_labels(root, Dataset(root).lengths), strict=True):
        np.testing.assert_array_equal(after, [*before[2:], *before[-1:], *before[-1:]])

    run = new_run(tmp_path, "evaluate", SEGMENTATION | {"min_kept": 2}, **addresses)
    result = finish_after_a_stop(run)
    check_figures(result, "frame_accuracy", "balanced_accuracy")
    figures = {name: figure["value"] for name, figure in result["figures"].items()}
    assert figures["kept"] * figures.get("kept_accuracy", 0) == pytest.approx(figures["frame_accuracy"])
    (picture,) = run.artifact("frames.json")
    assert len(frames_of(run)["trajectory"]) == len(picture["truth"]) == len(picture["labels"])
    assert set(picture["truth"]) <= set(range(len(picture["skills"])))


@pytest.mark.e2e
@pytest.mark.parametrize(
    ("config", "missing"),
    [
        (RELATIONS | {"task": "grid"}, "captions; grid offers none"),
        (LANDMARKS | {"task": "pendulum"}, "at-landmark, object-moves; pendulum offers none"),
        (DEMONSTRATIONS | {"task": "pendulum"}, "at-landmark; pendulum offers none"),
        (RECIPES | {"task": "pendulum"}, "with skills; pendulum has none"),
        (SEGMENTATION | {"task": "pendulum"}, "an expert and skills; pendulum lacks them"),
        ({"task": "pendulum", "policy": "expert"}, "pendulum has none"),
        ({"task": "blocks", "policy": "random"}, "blocks is reward-free"),
        ({"form": "sentences", "task": "grid", "policy": "random"}, "takes goal texts"),
    ],
)
def test_a_task_that_lacks_what_a_form_needs_is_refused(
    evaluation: Callable[..., Any], config: dict[str, Any], missing: str
) -> None:
    with pytest.raises(InvalidInput, match=missing) as error:
        evaluation(config).do()
    assert error.value.field in ("config.task", "config.policy")


def test_a_task_that_lacks_predicates_is_refused_by_their_names() -> None:
    bare = Task("bare", "bare", "", (), ActionSpec(1, 0, ("x",)), 0.1, (), 10, (Predicate("at-landmark"),))
    check_predicates(bare, ["at-landmark"], form="landmarks")
    with pytest.raises(InvalidInput, match="needs the predicates object-moves; bare offers at-landmark") as error:
        check_predicates(bare, ["at-landmark", "object-moves"], form="landmarks")
    assert error.value.field == "config.task"


@pytest.mark.parametrize(
    "config",
    [
        {"form": "beauty", "task": "grid"},
        LANDMARKS | {"policy": "expert"},
        LANDMARKS | {"policy": {"model": "default", "goal_text": "a red block"}},
        RECIPES | {"policy": {"model": "skills", "recipe": ["move-red"]}},
        DEMONSTRATIONS | {"policy": {"model": "default", "goal_text": "a red block"}},
        DEMONSTRATIONS | {"switching": "truth"},
        {"form": "sentences", "task": "blocks", "policy": {"model": "words", "goal_text": "a red block"}},
        RELATIONS | {"policy": "random"},
        SEGMENTATION | {"smoothing": -1},
    ],
)
def test_what_is_no_configuration_of_a_form_is_refused(config: dict[str, Any]) -> None:
    with pytest.raises(InvalidInput) as error:
        KINDS["evaluate"].parse(config)
    assert error.value.field.startswith("config")


def flags(*rows: str) -> Any:
    """Returns bool (N, T) from rows of digits."""
    return np.array([[each == "1" for each in row] for row in rows])


def test_the_baseline_of_recipes_is_the_explorer_of_a_task_that_has_one() -> None:
    sim, task = (
        SyncClient(SimClient(Channel("localhost:1"))),
        Task("t", "w", "", (), ActionSpec(1, 0, ("x",)), 0.1, (), 5),
    )
    with sim:
        described = [random_behaviour(sim, replace(task, has_explorer=has)).description for has in (False, True)]
    assert [each.get("explorer", False) for each in described] == [False, True]


def test_what_was_done_is_set_against_what_was_told() -> None:
    told_left, told_right = [[1, 1, 1, 0], [0, 0, 0, 0]], [[0, 0, 1, 0], [1, 1, 0, 0]]  # by task: left, right
    successes = np.array([told_left, told_right], np.float64).swapaxes(0, 1)  # (tasks, texts, N)
    assert confusion_matrix(successes, tasks=["left", "right"], texts=["to the left", "to the right"]) == [
        {"goal_text": "to the left", "done": {"left": 0.75, "right": 0.0}, "none": 0.25},
        {"goal_text": "to the right", "done": {"left": 0.25, "right": 0.5}, "none": 0.25},
    ]
    figure = told_is_done(successes, [0, 1], seed=0)["told_is_done"]
    assert (figure.value, figure.baseline) == (5 / 6, 0.5)
    assert told_is_done(np.zeros((2, 3, 4)), [0, 1], seed=0) == {}


def test_landmarks_count_where_the_robot_was_while_it_pursued_them() -> None:
    pursuit = pursuit_of(flags("01000", "00100", "00001", "00000"), np.array([0, 1, 1, 2, 2]))
    assert pursuit.landmark.tolist() == [0, 0, 1, 1, 2]
    assert pursuit.recognized.tolist() == [True, False, False, False]
    assert pursuit.reached.tolist() == [True, True, True, False]


def test_a_last_landmark_counts_when_the_reply_says_that_all_are_over() -> None:
    pursuit = pursuit_of(flags("11"), np.array([1, 1]))
    assert pursuit.recognized.tolist() == pursuit.reached.tolist() == [True]
    assert pursuit.is_active.tolist() == [True, False]


def test_a_policy_without_goals_goes_on_when_truly_there_or_the_time_is_up() -> None:
    reached = reached_by_truth(flags("1000", "0000", "0001"), max_steps=2)
    assert reached.tolist() == [True, False, True]


def test_an_attempt_lasts_until_the_policy_goes_on() -> None:
    answers = np.array([0, 0, 0, 1, 1, 3])
    assert [attempt_bounds(answers, place) for place in range(4)] == [(0, 3), (3, 5), (5, 5), (5, 6)]


def test_a_skill_that_a_policy_never_learned_is_skipped_and_has_no_attempt() -> None:
    recipe, known = ("a", "b", "c", "d"), ("c", "a", "e")
    assert known_skills(recipe, known) == ("a", "c")
    index = places_in_recipe(np.array([0, 0, 1, 2]), recipe, known)
    assert index is not None
    assert index.tolist() == [0, 0, 2, 4]
    assert [attempt_bounds(index, place) for place in range(4)] == [(0, 2), (2, 2), (2, 3), (3, 3)]
    assert known_skills(recipe, ()) == recipe
    assert known_skills(recipe, ("e",)) == ("e",)
    assert places_in_recipe(np.array([0, 1]), recipe, ("e",)).tolist() == [4, 4]  # type: ignore[union-attr]
    assert places_in_recipe(None, recipe, known) is None


# --- demonstrations


def test_landmarks_are_reached_in_order_and_skipped_ones_end_what_counts() -> None:
    at = np.array([[0, 0, 1, 0, 0, 0], [1, 0, 1, 1, 0, 0], [0, 1, 0, 0, 0, 0], [0, 0, 0, 0, 1, 1]], bool)
    assert times_in_order(at) == [2, 2]
    assert times_in_order(at[:2]) == [2, 2]
    assert times_in_order(at[2:]) == [1, 4]
    assert times_in_order(at[2:, :1]) == []


def test_a_robot_has_left_a_landmark_when_its_next_goal_begins_or_at_the_end() -> None:
    demonstrated = np.array([2, 4, 5])
    assert times_left(np.array([0, 0, 1, 3]), demonstrated, length=4).tolist() == [2, 3, 3]
    assert times_left(np.array([0, 1]), demonstrated, length=2).tolist() == [1, 2, 2]
    assert times_left(None, demonstrated, length=4).tolist() == [2, 4, 4]


def test_a_robot_stops_where_it_first_says_that_it_is_at_the_last_landmark() -> None:
    at = np.array([[1, 0, 0, 0], [0, 0, 1, 0]], bool)
    assert stopped_at(at, np.array([1, 1, 2]))
    assert not stopped_at(at, np.array([1, 2, 2]))
    assert not stopped_at(at, np.array([0, 1, 1]))


def test_an_efficiency_is_of_the_way_to_the_farthest_landmark_and_at_most_one() -> None:
    demonstrated = np.array([10, 20, 25])
    assert efficiency(demonstrated, [15, 40]) == 0.5
    assert efficiency(demonstrated, [5]) == 1
    assert efficiency(demonstrated, [0]) == 1
    assert efficiency(demonstrated, []) == 0


@pytest.mark.e2e
@pytest.mark.parametrize("switching", ["policy", "steps", "truth"])
def test_demonstrations_are_followed_by_their_goal_images(evaluation: Callable[..., Any], switching: str) -> None:
    followed = {"form": "demonstrations", "task": "blocks", "policy": {"model": "default"}, "switching": switching}
    config = followed | {"paths": ["move-red", "move-yellow"], "every": 20, "length_factor": 1} | ROUNDS
    result = finish_after_a_stop(evaluation(config))
    check_medians(result, "completion", "efficiency")
    paths = result["paths"]
    assert [each["path"] for each in paths] == ["move-red", "move-yellow"]
    assert [each["landmarks"] for each in paths] == [-(-each["steps"] // 20) for each in paths]
    assert (result["switching"], result["model"]["name"]) == (switching, "default")
    assert {"ended", "steps", "farthest_at", *(f"failed.{each}" for each in FAILURES)} <= set(result["figures"])


@pytest.mark.e2e
def test_a_round_ends_once_the_policy_has_gone_on_from_all_landmarks(evaluation: Callable[..., Any]) -> None:
    followed = DEMONSTRATIONS | {"policy": {"model": "default"}, "switching": "steps", "steps_per_landmark": 1}
    run = evaluation(followed | {"paths": ["move-red"], "every": 20, "episodes": 2, "num_envs": 2})
    assert run.do()
    (path,) = run.artifact("result.json")["paths"]
    (line,) = (run.folder / "checkpoints" / "rounds.jsonl").read_bytes().splitlines()
    for trial in json.loads(line)["trials"]:
        assert trial["steps"] == path["landmarks"] < path["steps"]
        assert trial["ended"]
        assert len(trial["confidence"]) == len(trial["at_landmark"]) == trial["steps"]
        assert trial["farthest_at"] == (trial["times"] or [0])[-1]
        assert sum(trial[f"failed.{each}"] for each in FAILURES) == (trial["completion"] < 1)


@pytest.mark.e2e
def test_a_trial_lasts_its_most_steps_however_long_its_demonstration_is(evaluation: Callable[..., Any]) -> None:
    run = evaluation(DEMONSTRATIONS | {"paths": ["move-red"], "every": 20, "most_steps": 7} | ROUNDS)
    assert run.do()
    result = run.artifact("result.json")
    assert result["figures"]["steps"]["value"] == 7 < result["paths"][0]["steps"]
    assert {f"failed.{each}" for each in FAILURES}.isdisjoint(result["figures"])


@pytest.mark.e2e
def test_a_demonstration_that_does_not_complete_its_path_asks_for_another_seed(services: dict[str, str]) -> None:
    request = CreateSessionRequest("blocks", num_envs=1, seed=0, privileged=True)
    with SyncClient(SimClient(Channel(services["FREEREIN_SIM_ADDRESS"]))) as sim:
        task = find_task(sim, "blocks")
        (idle,) = run_episodes(sim, request, exploration_policy(task.action), lambda: None, max_steps=2)
        with pytest.raises(FailedPrecondition, match="must complete its path; that of move-red does not") as error:
            check_completed(sim, task, "move-red", idle.states)
        check_completed(sim, replace(task, predicates=()), "move-red", idle.states)
    assert error.value.field == "config.demonstration_seed"


@pytest.mark.long  # a walk of hundreds of steps in the engine
@needs_engine
@pytest.mark.e2e
def test_the_expert_is_the_ceiling_of_its_demonstrations(evaluation: Callable[..., Any]) -> None:
    shown = {"paths": ["path-5"], "demonstration_conditions": ["heading-along-path"], "length_factor": 2}
    run = evaluation(DEMONSTRATIONS | shown | {"task": "doom", "policy": "expert", "episodes": 2, "num_envs": 2})
    assert run.do()
    result = run.artifact("result.json")
    check_medians(result, *(f"completion{units}" for units in ("", ".32", ".64")), "efficiency")
    figures = {name: figure["value"] for name, figure in result["figures"].items()}
    assert figures["completion"] == figures["success"] == 1
    assert figures["efficiency"] > 0.7  # it begins turned in any direction


@pytest.mark.long  # a rope of many joints
@pytest.mark.e2e
def test_numbers_of_a_task_are_reported_by_landmark_and_random_actions_are_its_explorers(
    evaluation: Callable[..., Any],
) -> None:
    short = {"task": "rope", "paths": ["s-shape"], "every": 3, "length_factor": 1, "episodes": 1, "num_envs": 1}
    expert, random = evaluation(DEMONSTRATIONS | short | {"policy": "expert"}), evaluation(DEMONSTRATIONS | short)
    assert expert.do()
    assert random.do()
    last = {}
    for name, run in (("expert", expert), ("random", random)):
        result = run.artifact("result.json")
        (path,) = result["paths"]
        assert len(path["tps-rpm"]) == path["landmarks"]
        assert result["figures"]["tps-rpm"]["value"] == pytest.approx(np.mean(path["tps-rpm"]))
        last[name] = result["figures"]["tps-rpm.last"]["value"]
    assert last["expert"] < last["random"]
    assert random.artifact("result.json")["explorer"]


def check_medians(result: dict[str, Any], *names: str) -> None:
    """Checks that a result has these medians, each within its interval, and the means beside them."""
    for name in names:
        for figure in (result["figures"][name], result["figures"][f"{name}.mean"]):
            assert 0 <= figure["low"] <= figure["value"] <= figure["high"] <= 1


@pytest.mark.e2e
def test_a_path_that_is_none_of_the_tasks_is_refused(evaluation: Callable[..., Any]) -> None:
    with pytest.raises(InvalidInput, match=r"among the task's skills, .*; got 1 others") as error:
        evaluation(DEMONSTRATIONS | {"paths": ["path-9"]}).do()
    assert error.value.field == "config.paths"
