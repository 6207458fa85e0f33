"""The rows of chapter 3: the pipelines that make them, and fits of their configurations on tiny datasets."""

from pathlib import Path

import numpy as np
import PIL.Image
import pytest
import torch
from experiments import doom, office, rope
from experiments.chapter3 import reach, resampled, sift
from experiments.chapter3.exploration import (
    CHOICE,
    DATA_OPTION,
    EXPERT,
    EXPLORING,
    RANDOM_SEARCH,
    SIFT,
    Exploration,
    Setting,
    is_fitted,
)
from experiments.chapter3.followed import samples
from experiments.chapter3.followers import publish_sampled
from experiments.workbench.results import Sample

from freerein.config import parse
from freerein.data import DatasetSpec, create, dataset_path, integer_fps
from freerein.learning import weights
from freerein.learning.fit_dataset import FitDataset
from freerein.learning.model_files import MODEL, read_card, save_model
from freerein.model_store import ModelStore
from freerein.types.common import ModelRef, Trajectory
from freerein_imitation.methods import METHODS
from freerein_imitation.methods.shared.goal_images.recognizer import GoalRecognizerNetwork, GoalRecognizerSpec
from freerein_imitation.model.policy import ControlSpec
from freerein_orchestrator.kinds import KINDS
from freerein_sim.worlds.tasks import tasks
from freerein_sim.worlds.world import WorldSpec

TINY = {"steps": 3, "batch_size": 2, "features": 8, "hidden_size": 8}
WORLDS = {each.EXPLORATION.world: each.EXPLORATION for each in (doom, office, rope)}
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
    KINDS["pipeline"].parse({"steps": list(exploration.shared)})
    for arm in (arm for arm in exploration.arms if arm.method != EXPLORING):
        steps = [*([exploration.fit_step(arm)] if is_fitted(arm.method) else []), *exploration.steps(arm)]
        KINDS["pipeline"].parse({"steps": steps})
        assert arm.seed not in {each["config"]["seed"] for each in steps if each["kind"] == "evaluate"}
    unfitted = {arm.method for arm in exploration.arms if not is_fitted(arm.method)}
    assert unfitted - {EXPLORING, SIFT} == {EXPERT, RANDOM_SEARCH}
    assert all(exploration.collected(data)["dataset"] == data for data in exploration.seeds)


@each_world
def test_a_setting_has_as_many_demonstrations_as_its_evaluations_show(exploration: Exploration) -> None:
    for setting in exploration.all_settings.values():
        shown = [each.get("paths") or tasks()[each["task"]].spec.skills for each in setting.evaluations]
        assert sum(map(len, shown)) == setting.demonstrations
        assert setting.evaluations[0]["episodes"] % len(shown[0]) == 0


@each_world
def test_what_is_claimed_is_evaluated(exploration: Exploration) -> None:
    name, figure = exploration.chooses
    assert name in exploration.settings[CHOICE]
    assert figure in exploration.figures


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
    setting = Setting(({"demonstration_seed": 1}, {"demonstration_seed": 2}), demonstrations=2)
    assert setting.names("knot") == ["knot_0", "knot_1"]
    trials = {"knot_0": [{"success": True, "cost": [1, 3]}] * 2, "knot_1": [{"success": False, "cost": [5, 7]}] * 2}
    found = dict(samples({"greedy": trials}, {"knot": setting}, ("success", "cost", "stopped")))
    assert found == {
        "greedy.knot.success": Sample([True, False] * 2, [1] * 4),
        "greedy.knot.cost": Sample([4, 12] * 2, [2] * 4),
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
