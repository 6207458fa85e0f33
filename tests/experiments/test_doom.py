"""The rows of table 3.3: the pipelines that make them, and fits of their configurations on a tiny dataset."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
from experiments import doom
from experiments.workbench.arms import Arm

from freerein.config import parse
from freerein.data import DatasetSpec, create, dataset_path
from freerein.learning import weights
from freerein.learning.fit_dataset import FitDataset
from freerein.learning.model_files import save_model
from freerein.model_store import ModelStore
from freerein.types.common import Camera, Trajectory
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
        steps = doom.steps(arm)
        KINDS["pipeline"].parse({"steps": steps})
        assert arm.seed not in {each["config"]["seed"] for each in steps if each["kind"] == "evaluate"}
    assert {arm.method for arm in doom.EXPERIMENT.arms} == {doom.RANDOM_SEARCH, *doom.ROWS}


@pytest.mark.parametrize("row", doom.ROWS)
def test_every_row_is_a_fit(data_dir: Path, row: str) -> None:
    arm = next(arm for arm in fits() if arm.method == row)
    given = {**doom.steps(arm)[0]["config"]["config"], **TINY}
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
