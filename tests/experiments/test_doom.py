"""The rows of table 3.3: the pipelines that make them, and fits of their configurations on a tiny dataset."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
from experiments import doom
from experiments.chapter3 import resampled
from experiments.chapter3.followed import DEMONSTRATIONS, EXPERT, RANDOM_SEARCH, SETTINGS
from experiments.workbench.arms import Arm
from experiments.workbench.results import Sample

from freerein.config import parse
from freerein.data import DatasetSpec, create, dataset_path
from freerein.learning import weights
from freerein.learning.fit_dataset import FitDataset
from freerein.learning.model_files import MODEL, read_card, save_model
from freerein.model_store import ModelStore
from freerein.types.common import Camera, ModelRef, Trajectory
from freerein_imitation.methods import METHODS
from freerein_imitation.methods.shared.goal_images.recognizer import GoalRecognizerNetwork, GoalRecognizerSpec
from freerein_imitation.model.policy import ControlSpec
from freerein_orchestrator.kinds import KINDS
from freerein_sim.worlds.tasks import tasks

TINY = {"steps": 3, "batch_size": 2, "features": 8, "hidden_size": 8}


@pytest.fixture(scope="module")
def data_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data directory with noise as the data of both explorations, and an untrained recognizer."""
    root, rng, spec = tmp_path_factory.mktemp("data"), np.random.default_rng(0), tasks()["doom"].spec
    camera, action = Camera("view", 42, 42, 1), spec.action
    for name in ("random", "curiosity"):
        described = DatasetSpec(9, {camera.name: (42, 42, 1)}, action, "test", control_dt_s=spec.control_dt_s)
        with create(dataset_path(root, name), described) as writer:
            for _ in range(4):
                frames = rng.integers(0, 256, (20, 42, 42, 1), np.uint8)
                writer.append(Trajectory({camera.name: frames}, rng.integers(0, 4, (20, 1))))
    recognizer = GoalRecognizerNetwork(GoalRecognizerSpec(cameras=(camera,), action=action, encoder="convolutional"))
    weights.initialise(recognizer, generator=torch.Generator().manual_seed(0))
    card = {"method": "goal_recognizer", **ControlSpec(spec.control_dt_s, 0.9, 30).to_card()}
    (root / "made").mkdir()
    save_model(recognizer, root / "made", card=card)
    store = ModelStore(root / "models" / "imitation")
    store.activate(store.publish("recognizer", root / "made"))
    return root


def fits() -> Iterator[Arm]:
    return (arm for arm in doom.EXPERIMENT.arms if arm.method in doom.ROWS)


def test_the_orchestrator_takes_all_pipelines_and_evaluations_have_seeds_of_their_own() -> None:
    KINDS["pipeline"].parse({"steps": doom.shared_steps()})
    for arm in doom.EXPERIMENT.arms:
        steps = [*([doom.fit_step(arm)] if doom.is_fitted(arm) else []), *doom.steps(arm)]
        KINDS["pipeline"].parse({"steps": steps})
        assert arm.seed not in {each["config"]["seed"] for each in steps if each["kind"] == "evaluate"}
    unfitted = {arm.method for arm in doom.EXPERIMENT.arms if not doom.is_fitted(arm)}
    assert unfitted == {EXPERT, RANDOM_SEARCH}


def test_every_setting_has_as_many_demonstrations_as_intervals_take() -> None:
    for name in (task for settings in SETTINGS.values() for task in settings.values()):
        assert len(tasks()[name].spec.skills) == DEMONSTRATIONS


def test_an_interval_is_over_demonstrations_not_only_over_their_starts() -> None:
    episodes = np.zeros((1, DEMONSTRATIONS, 50))
    episodes[:, 0] = 1.0  # one demonstration is followed always, the others never
    low, high = resampled.interval(episodes, resampled.mean)
    assert low == 0.0
    assert high >= 0.6
    assert resampled.median(episodes) == 0.0


def test_trials_are_sorted_by_the_demonstration_that_they_follow() -> None:
    followed = [trial % DEMONSTRATIONS for trial in range(10)]
    episodes = resampled.by_demonstration([Sample(followed, [1] * 10)])
    np.testing.assert_array_equal(episodes, np.arange(DEMONSTRATIONS)[None, :, None].repeat(2, axis=2))


def test_the_interval_of_a_median_has_the_ranks_of_a_binomial() -> None:
    assert resampled.median_interval(np.arange(100.0)) == (40.0, 60.0)


@pytest.mark.parametrize("row", doom.ROWS)
def test_every_row_is_a_fit(data_dir: Path, row: str) -> None:
    arm = next(arm for arm in fits() if arm.method == row)
    given = {**doom.fit_step(arm)["config"]["config"], **TINY}
    given |= {name: 1 for name in given if name.endswith("pretraining_steps")}
    config = METHODS.resolve(data_dir, arm.options["data"], given, threads=1)
    method = METHODS.by_name[config.pop("method")]
    source = FitDataset.open(data_dir, arm.options["data"])
    learner = method.prepare(source, parse(method.config, config), torch.device("cpu"))
    state = learner.init(torch.Generator().manual_seed(0))
    for _ in range(3):
        state, losses = learner.update(state, np.arange(2))
        assert all(map(np.isfinite, losses.values()))
    assert (learner.stored is None) == (row == "gsp_stop")


def test_a_policy_that_draws_its_actions_has_the_same_weights_and_another_card(tmp_path: Path) -> None:
    made, fitted, drawn = tmp_path / "made", tmp_path / "fitted", tmp_path / "drawn"
    made.mkdir()
    (made / MODEL.card).write_text('{"method": "goal_conditioned", "spec": {"temperature": 0.0}}')
    (made / MODEL.weights).write_bytes(b"weights")
    store = ModelStore(fitted / "models" / "imitation")
    store.activate(store.publish("policy", made))
    for _ in range(2):  # an arm that was stopped publishes again
        doom.publish_sampled(fitted, drawn)
    store = ModelStore(drawn / "models" / "imitation")
    folder = store.folder(ModelRef("policy", store.active_version("policy")))
    assert read_card(folder)["spec"] == {"temperature": 1.0}
    assert (folder / MODEL.weights).read_bytes() == b"weights"
