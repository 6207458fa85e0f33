"""Which policy a name refers to."""

from pathlib import Path

import pytest
import torch

from freerein.errors import InvalidInput
from freerein.learning.actor_critic.networks import ActorCriticSpec
from freerein.learning.actor_critic.policy_files import load_policy, save_policy
from freerein.model_store import ModelStore
from freerein.types.common import ModelRef
from freerein_orchestrator.kinds.context import RunContext
from freerein_orchestrator.rl.initial_network import init_network

FIELD = "config.teachers"


def make_policy(folder: Path, seed: int) -> Path:
    network = init_network(ActorCriticSpec(vector_size=2, hidden_size=2), torch.Generator().manual_seed(seed))
    save_policy(network, folder, card={})
    return folder


def activate_version(data_dir: Path, seed: int) -> Path:
    """Makes a new version of the model `teacher` the active one; returns its folder."""
    store = ModelStore(data_dir / "models" / "orchestrator")
    ref = store.publish("teacher", make_policy(data_dir / "new", seed))
    store.activate(ref)
    return store.folder(ref)


@pytest.fixture
def run(tmp_path: Path) -> RunContext:
    folder = tmp_path / "runs" / ("a" * 32)
    return RunContext(folder, folder.name, tmp_path, "cpu", {"FREEREIN_SHIPPED_DIR": str(tmp_path / "none")}, bool)


def teacher(context: RunContext) -> Path:
    return context.policies.folder("teacher", field=FIELD)


def test_a_name_is_an_earlier_steps_or_a_models_or_refused(run: RunContext, tmp_path: Path) -> None:
    step = run.child("student", first_step=0)
    with pytest.raises(InvalidInput):
        teacher(step)
    model = activate_version(tmp_path, 0)
    assert (teacher(run), teacher(step)) == (model, model)
    policy = make_policy(run.folder / "parts" / "teacher" / "artifacts", 1)
    assert (teacher(run), teacher(step)) == (model, policy)


@pytest.mark.parametrize("made", [True, False])
def test_a_run_that_has_made_no_policy_is_refused_with_the_field_that_names_it(
    run: RunContext, tmp_path: Path, made: bool
) -> None:
    other = "b" * 32
    if made:
        (tmp_path / "runs" / other / "checkpoints").mkdir(parents=True)
    with pytest.raises(InvalidInput, match="must have made a policy" if made else "must exist") as error:
        run.policies.load(other, field=FIELD)
    assert error.value.field == FIELD
    assert error.value.hint


@pytest.mark.parametrize("name", ["8bc1f7", "8bc1f7" + "0" * 25, "ppo-yellow-left-of-green-8bc1f7"])
def test_a_run_is_found_by_the_first_digits_of_its_id_and_by_its_readable_name(
    run: RunContext, tmp_path: Path, name: str
) -> None:
    folder = tmp_path / "runs" / ("8bc1f7" + "0" * 26)
    make_policy(folder / "artifacts", 0)
    (folder / "config.json").write_text("{}")
    assert run.policies.folder(name, field=FIELD) == folder / "artifacts"
    (tmp_path / "runs" / ("8bc1f7" + "0" * 25 + "1")).mkdir()
    (tmp_path / "runs" / ("8bc1f7" + "0" * 25 + "1") / "config.json").write_text("{}")
    with pytest.raises(InvalidInput):  # two runs begin so
        run.policies.folder(name, field=FIELD)


def test_a_pinned_name_keeps_the_version_that_was_active(run: RunContext, tmp_path: Path) -> None:
    first = activate_version(tmp_path, 0)
    run.policies.pin(["teacher"])
    second = activate_version(tmp_path, 1)
    run.policies.pin(["teacher"])
    assert (teacher(run), teacher(run.child("another", first_step=0))) == (first, second)
    assert load_policy(teacher(run), device="cpu").card != load_policy(second, device="cpu").card


def test_a_stored_policy_is_found_by_name_and_version_and_refused_without(run: RunContext, tmp_path: Path) -> None:
    with pytest.raises(InvalidInput):
        run.policies.model_folder(ModelRef("teacher"), field=FIELD)
    first, second = activate_version(tmp_path, 0), activate_version(tmp_path, 1)
    assert run.policies.model_folder(ModelRef("teacher"), field=FIELD) == second
    assert run.policies.model_folder(ModelRef("teacher", first.name), field=FIELD) == first
    with pytest.raises(InvalidInput):
        run.policies.model_folder(ModelRef("teacher", "0" * 12), field=FIELD)
