"""The rows of chapter 3: the pipelines that make them, and fits of their configurations on tiny datasets."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import PIL.Image
import pytest
import torch
from experiments import doom, office, rope
from experiments.chapter3 import fits, knots, reach, resampled, sift
from experiments.chapter3.exploration import (
    CHOICE,
    DATA_OPTION,
    EXPERT,
    EXPLORING,
    FIT_OPTION,
    PILOT,
    RANDOM_SEARCH,
    SETTINGS_OPTION,
    SIFT,
    TRUE_SWITCHING,
    Choice,
    Exploration,
    Setting,
    is_fitted,
)
from experiments.chapter3.followed import samples
from experiments.chapter3.followers import Followers, publish_sampled
from experiments.workbench.arms import is_current
from experiments.workbench.pipelines import fit_step, run_folder
from experiments.workbench.results import Sample, load_all

from freerein.config import parse
from freerein.data import Dataset, DatasetSpec, create, dataset_path, integer_fps
from freerein.errors import FailedPrecondition
from freerein.learning import weights
from freerein.learning.fit_dataset import FitDataset
from freerein.learning.model_files import MODEL, read_card, save_model
from freerein.model_store import ModelStore
from freerein.types.common import ModelRef, Trajectory
from freerein.types.sim import DemonstrateRequest
from freerein_imitation.methods import METHODS
from freerein_imitation.methods.shared.goal_images.recognizer import GoalRecognizerNetwork, GoalRecognizerSpec
from freerein_imitation.model.policy import ControlSpec
from freerein_orchestrator.kinds import KINDS
from freerein_sim.workers.demonstrations import make_demonstration
from freerein_sim.worlds.tasks import tasks
from freerein_sim.worlds.world import WorldSpec

TINY = {"steps": 3, "batch_size": 2, "features": 8, "hidden_size": 8}
WORLDS = {each.EXPLORATION.world: each.EXPLORATION for each in (doom, office, rope)}
EXPERIMENTS = {each.EXPLORATION.world: each.EXPERIMENT for each in (doom, office, rope)}
each_world = pytest.mark.parametrize("exploration", WORLDS.values(), ids=WORLDS)


@pytest.fixture(scope="module")
def data_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data directory with noise as the data of all explorations, and an untrained recognizer of each world."""
    root = tmp_path_factory.mktemp("data")
    for world, exploration in WORLDS.items():
        for data in exploration.seeds:
            _write_noise(dataset_path(root, f"{world}-{data}"), tasks()[world].spec)
        _publish_recognizer(root, f"{world}-recognizer", tasks()[world].spec)
    return root


def _write_noise(folder: Path, spec: WorldSpec) -> None:
    (camera,), rng = spec.cameras, np.random.default_rng(0)
    shape = camera.height, camera.width, camera.channels
    described = DatasetSpec(
        integer_fps(spec.control_dt_s), {camera.name: shape}, spec.action, "test", control_dt_s=spec.control_dt_s
    )
    with create(folder, described) as writer:
        for _ in range(4):
            frames = rng.integers(0, 256, (20, *shape), np.uint8)
            drawn = rng.integers(0, 4, (20, 1)) if spec.action.choices else rng.uniform(-1, 1, (20, 4))
            writer.append(Trajectory({camera.name: frames}, drawn.astype(spec.action.dtype)))


def _publish_recognizer(root: Path, name: str, spec: WorldSpec) -> None:
    described = GoalRecognizerSpec(cameras=spec.cameras, action=spec.action, encoder="convolutional")
    recognizer = GoalRecognizerNetwork(described)
    weights.initialise(recognizer, generator=torch.Generator().manual_seed(0))
    card = {"method": "goal_recognizer", **ControlSpec(spec.control_dt_s, 0.9, 30).to_card()}
    (root / name).mkdir()
    save_model(recognizer, root / name, card=card)
    store = ModelStore(root / "models" / "imitation")
    store.activate(store.publish(name, root / name))


@each_world
def test_the_orchestrator_takes_all_pipelines_and_evaluations_have_seeds_of_their_own(exploration: Exploration) -> None:
    KINDS["pipeline"].parse({"steps": list(exploration.collects)})
    KINDS["pipeline"].parse({"steps": [exploration.recognizer_step()]})
    for arm in (arm for arm in exploration.arms if arm.method != EXPLORING):
        fitted = [exploration.fit_step(arm)] if is_fitted(arm.method) else []
        tried = exploration.pilot_steps(arm) if arm.method == PILOT else []
        steps = [*fitted, *tried, *exploration.steps(arm)]
        KINDS["pipeline"].parse({"steps": steps})
        assert arm.seed not in {each["config"]["seed"] for each in steps if each["kind"] == "evaluate"}
    unfitted = {arm.method for arm in exploration.arms if not is_fitted(arm.method)}
    assert unfitted - {EXPLORING, PILOT, SIFT} == {EXPERT, RANDOM_SEARCH}
    assert all(exploration.collected(data)["dataset"] == data for data in exploration.seeds)


@each_world
def test_a_setting_has_as_many_demonstrations_as_its_evaluations_show(exploration: Exploration) -> None:
    for setting in exploration.all_settings.values():
        shown = [each.get("paths") or tasks()[each["task"]].spec.skills for each in setting.evaluations]
        assert sum(map(len, shown)) == setting.demonstrations
        assert setting.evaluations[0]["episodes"] % len(shown[0]) == 0


@each_world
def test_what_is_claimed_is_evaluated_and_chosen_by_a_setting_that_chooses(exploration: Exploration) -> None:
    for setting in exploration.all_settings.values():
        assert setting.choice.setting in exploration.settings[CHOICE]
        assert setting.choice.figure in exploration.figures
    for measured in EXPERIMENTS[exploration.world].report.measured:
        assert measured.figure in exploration.figures
        assert exploration.all_settings[measured.setting].choice.statistic == measured.statistic


def test_every_demonstration_of_a_rope_is_followed_from_ropes_of_its_own() -> None:
    shown = [each for setting in rope.EXPLORATION.all_settings.values() for each in setting.evaluations]
    assert len({each["seed"] for each in shown}) == len(shown)


@each_world
def test_true_switching_comes_after_the_fits_of_seed_0_one_of_which_it_shares(exploration: Exploration) -> None:
    for kind in exploration.settings:
        followers = [arm for arm in exploration.arms if arm.options.get(SETTINGS_OPTION) == kind]
        methods = [arm.method for arm in followers]
        (at,) = (number for number, method in enumerate(methods) if method == TRUE_SWITCHING)
        assert all(arm.seed == 0 for arm in followers[:at])
        assert exploration.claimed[0] in methods[:at]
        assert all(arm.seed > 0 for arm in followers[at + 1 :])


@each_world
def test_learning_rates_are_those_that_the_pilot_chose(exploration: Exploration) -> None:
    experiment = EXPERIMENTS[exploration.world]
    current = {arm.name: arm for arm in exploration.arms}
    stored = [each for each in load_all(Path("experiments/results") / exploration.world) if each.method == PILOT]
    tried = [each for each in stored if each.name in current and is_current(experiment, current[each.name], each)]
    for fit, rate in exploration.lr.items():
        rates = exploration.rates[fit]
        if sum(each.options[FIT_OPTION] == fit for each in tried) == len(rates):
            assert rate == fits.best_rate(tried, fit)
            assert min(rates) < rate < max(rates)


@each_world
def test_a_chosen_learning_rate_is_that_of_fits_and_changes_neither_pilot_nor_data(exploration: Exploration) -> None:
    other = replace(exploration, lr=dict.fromkeys(exploration.lr, 0.123))
    before, after = (Followers(each, EXPERIMENTS[exploration.world].report) for each in (exploration, other))
    for arm in exploration.arms:
        assert (before.config(arm) == after.config(arm)) == (not is_fitted(arm.method))
    fitted = next(arm for arm in exploration.arms if is_fitted(arm.method))
    assert other.fit_step(fitted)["config"]["config"]["lr"] == 0.123
    assert other.recognizer_step()["config"]["config"]["lr"] == 0.123


def test_a_fit_has_its_losses_beside_that_of_a_constant_guess_the_entropy_of_the_actions(
    tmp_path: Path, data_dir: Path
) -> None:
    dataset = data_dir / "datasets"
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "datasets").symlink_to(dataset)
    publish_card(tmp_path, {"validation_loss": 1.5, "best_step": 40})
    write_metrics(tmp_path, {10: 2.5, 20: 1.75, 30: 1.5})
    step = fit_step("policy", "imitation", "doom-curiosity", steps=50)
    found = dict(fits.figures(tmp_path, step))
    source = Dataset(dataset_path(data_dir, "doom-curiosity"))
    _, counts = np.unique(np.concatenate([source.actions(index) for index in range(len(source))]), return_counts=True)
    shares = counts / counts.sum()
    assert found == {
        "policy.validation_loss": 1.5,
        "policy.best_step": 40,
        "policy.validation_loss_halfway": 1.75,
        "policy.constant_loss": pytest.approx(-(shares * np.log(shares)).sum(), abs=1e-5),
    }


def publish_card(folder: Path, figures: dict[str, float]) -> None:
    """Publishes a policy without weights in the folder of a pipeline."""
    made, store = folder / "made", ModelStore(folder / "data" / "models" / "imitation")
    made.mkdir()
    (made / MODEL.card).write_text(json.dumps({"figures": figures}))
    (made / MODEL.weights).write_bytes(b"weights")
    store.activate(store.publish("policy", made))


def write_metrics(folder: Path, losses: dict[int, float]) -> None:
    """Writes held-out losses by update as those of the fit that the folder's pipeline ran, and a row of training."""
    started, fit = run_folder(folder) / "parts" / "policy", folder / "data" / "fits" / "imitation" / "made"
    for each in (started, fit):
        each.mkdir(parents=True)
    (started / "fit.json").write_text(json.dumps({"id": "made"}))
    rows = [{"step": 5, "train_loss": 3.0}, *({"step": step, "validation_loss": loss} for step, loss in losses.items())]
    (fit / "metrics.jsonl").write_text("".join(f"{json.dumps(row)}\n" for row in rows))


def test_collected_displacements_are_made_again_and_their_knots_counted(tmp_path: Path) -> None:
    request = DemonstrateRequest("rope", "random", count=1, seed=3, height=16, width=16)
    made = make_demonstration(tasks()["rope"], tasks()["rope"].make(), request).trajectory
    recorded = replace(made, frames={"above": made.frames["above"][:2]}, actions=made.actions[:2], terminated=None)
    described = DatasetSpec(1.0, {"above": (16, 16, 3)}, tasks()["rope"].spec.action, "rope", control_dt_s=1.0)
    with create(tmp_path / "kept", described) as writer:
        writer.append(recorded)
    found = knots.count({"task": "rope", "seed": 3}, Dataset(tmp_path / "kept"))
    assert found == {knots.DISPLACEMENTS: 2, knots.KNOTS: 0}
    with pytest.raises(FailedPrecondition, match="its actions are others"):
        knots.count({"task": "rope", "seed": 4}, Dataset(tmp_path / "kept"))


def test_an_interval_is_over_demonstrations_not_only_over_their_starts() -> None:
    episodes = np.zeros((1, 5, 50))
    episodes[:, 0] = 1.0  # one demonstration is followed always, the others never
    low, high = resampled.interval(episodes, resampled.mean)
    assert low == 0.0
    assert high >= 0.6
    assert resampled.median(episodes) == 0.0


def test_trials_are_sorted_by_the_demonstration_that_they_follow() -> None:
    followed = [trial % 5 for trial in range(10)]
    episodes = resampled.by_demonstration([Sample(followed, [1] * 10)], demonstrations=5)
    np.testing.assert_array_equal(episodes, np.arange(5)[None, :, None].repeat(2, axis=2))


@pytest.mark.parametrize(
    ("world", "row"), [(world, row) for world, exploration in WORLDS.items() for row in exploration.rows]
)
def test_every_row_is_a_fit(data_dir: Path, world: str, row: str) -> None:
    exploration = WORLDS[world]
    arm = next(arm for arm in exploration.arms if arm.method == row)
    given = {**exploration.fit_step(arm)["config"]["config"], **TINY}
    given |= {name: 1 for name in given if name.endswith("pretraining_steps")}
    if "recognizer" in given:
        given["recognizer"] = f"{world}-recognizer"
    data = f"{world}-{arm.options[DATA_OPTION]}"
    config = METHODS.resolve(data_dir, data, given, threads=1)
    method = METHODS.by_name[config.pop("method")]
    source = FitDataset.open(data_dir, data)
    learner = method.prepare(source, parse(method.config, config), torch.device("cpu"))
    state = learner.init(torch.Generator().manual_seed(0))
    for _ in range(3):
        state, losses = learner.update(state, np.arange(2))
        assert all(map(np.isfinite, losses.values()))
    assert (learner.stored is None) == (row == "gsp_stop")


def test_exploration_gets_as_far_as_its_parts_in_their_shares() -> None:
    still, fast = np.zeros((30, 2)), np.arange(30.0)[:, None] * [3.0, 4.0]
    found = reach.distances([[still, still[:4]], [fast]], shares=[3, 1])
    assert found["moved.10.median"] == 0
    assert found["moved.10.p90"] == 50
    assert found["moved.20.p90"] == 100


def test_sift_turns_to_where_the_goal_is_and_drives_where_it_is_larger(tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    sift.publish("office", tmp_path, model_name="policy")
    store = ModelStore(tmp_path / "models" / "imitation")
    policy = sift.load(store.folder(ModelRef("policy", store.active_version("policy"))), "cpu")
    (camera,), names = policy.spec.cameras, policy.spec.action.names
    rng = np.random.default_rng(0)
    wall = np.kron(rng.integers(0, 256, (40, 80, 3), np.uint8), np.ones((8, 8, 1), np.uint8))  # (320, 640, 3)
    middle = wall[80:240, 240:400]
    ahead = np.asarray(PIL.Image.fromarray(wall[98:222, 258:382]).resize((160, 160)))
    goals = {"left": wall[80:240, 180:340], "right": wall[80:240, 300:460], "forward": ahead, "": middle}
    codes = policy.encode_goals({camera.name: np.stack(list(goals.values()))})
    seen = {camera.name: np.stack([middle] * len(goals))}
    answer = policy.step(seen, codes, np.zeros((4, 1), np.int64), np.zeros((4, 0), np.float32))
    assert [names[action] for action in answer.actions[:3, 0, 0]] == ["left", "right", "forward"]
    assert answer.reached.tolist() == [0, 0, 0, 1]


def test_trials_of_several_evaluations_are_taken_in_turn() -> None:
    choice = Choice("knot", "success")
    setting = Setting(({"demonstration_seed": 1}, {"demonstration_seed": 2}), demonstrations=2, choice=choice)
    assert setting.names("knot") == ["knot_0", "knot_1"]
    trials = {"knot_0": [{"success": True, "cost": [1, 3]}] * 2, "knot_1": [{"success": False, "cost": [5, 7]}] * 2}
    found = dict(samples({"greedy": trials}, {"knot": setting}, ("success", "cost", "stopped")))
    assert found == {
        "greedy.knot.success": Sample([True, False] * 2, [1] * 4),
        "greedy.knot.cost": Sample([4, 12] * 2, [2] * 4),
        "greedy.knot.cost.0": Sample([1, 5] * 2, [1] * 4),
        "greedy.knot.cost.1": Sample([3, 7] * 2, [1] * 4),
    }
    costs = resampled.by_demonstration([found["greedy.knot.cost"]], demonstrations=2)
    np.testing.assert_array_equal(costs, [[[2, 2], [6, 6]]])


def test_a_policy_that_draws_its_actions_has_the_same_weights_and_another_card(tmp_path: Path) -> None:
    made, fitted, drawn = tmp_path / "made", tmp_path / "fitted", tmp_path / "drawn"
    made.mkdir()
    (made / MODEL.card).write_text('{"method": "goal_conditioned", "spec": {"temperature": 0.0}}')
    (made / MODEL.weights).write_bytes(b"weights")
    store = ModelStore(fitted / "models" / "imitation")
    store.activate(store.publish("policy", made))
    for _ in range(2):  # an arm that was stopped publishes again
        publish_sampled(fitted, drawn)
    store = ModelStore(drawn / "models" / "imitation")
    folder = store.folder(ModelRef("policy", store.active_version("policy")))
    assert read_card(folder)["spec"] == {"temperature": 1.0}
    assert (folder / MODEL.weights).read_bytes() == b"weights"
