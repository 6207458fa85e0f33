"""Which policy is meant by a name that a run builds on."""

from pathlib import Path

import pytest
import torch

from freerein.errors import InvalidInput
from freerein.learning import weights
from freerein.serving.model_store import ModelStore
from freerein_orchestrator import policy_artifact, taught
from freerein_orchestrator.networks import ActorCritic, ActorCriticSpec
from freerein_orchestrator.work import Work


def save_policy(folder: Path, seed: int) -> Path:
    network = ActorCritic(ActorCriticSpec(vector_size=2, hidden=2))
    weights.initialise(network, generator=torch.Generator().manual_seed(seed))
    policy_artifact.save(network, folder, card={})
    return folder


def activate_another(data_dir: Path, seed: int) -> Path:
    """Makes another version of the model `teacher` the active one; returns its folder."""
    store = ModelStore(data_dir / "models" / "orchestrator")
    ref = store.publish("teacher", save_policy(data_dir / "new", seed))
    store.activate(ref)
    return store.folder(ref)


@pytest.fixture
def run(tmp_path: Path) -> Work:
    folder = tmp_path / "runs" / ("a" * 32)
    return Work(folder, folder.name, {}, tmp_path, "cpu", {"FREEREIN_SHIPPED_DIR": str(tmp_path / "none")}, bool)


def meant(work: Work) -> Path:
    return taught.policy_folder(work, "teacher", field="config.teachers")


def test_a_name_is_an_earlier_steps_or_a_models_or_nobodys(run: Work, tmp_path: Path) -> None:
    part = run.part("student", {}, first_step=0)
    with pytest.raises(InvalidInput):
        meant(part)
    model = activate_another(tmp_path, 0)
    assert (meant(run), meant(part)) == (model, model)
    step = save_policy(run.folder / "parts" / "teacher" / "artifacts", 1)
    assert (meant(run), meant(part)) == (model, step)


def test_a_pinned_model_stays_the_version_that_was_active_when_it_was_pinned(run: Work, tmp_path: Path) -> None:
    first = activate_another(tmp_path, 0)
    taught.pin(run, ["teacher"])
    second = activate_another(tmp_path, 1)
    taught.pin(run, ["teacher"])
    assert (meant(run), meant(run.part("another", {}, first_step=0))) == (first, second)
    assert policy_artifact.load(meant(run), device="cpu").card != policy_artifact.load(second, device="cpu").card
