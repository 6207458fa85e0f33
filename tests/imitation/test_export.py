"""Exported policies: ONNX runtime, which knows nothing of freerein, does what the service does."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import pytest
from tests.imitation.test_policies import CASES, INPUTS
from tests.imitation.test_publish import CARD, FRAMES, RUN, leave, make
from typer.testing import CliRunner

from freerein.cli.__main__ import app
from freerein.learning.actor_critic.object_encoder import ObjectEncoderSpec
from freerein.learning.encoders.clip import ClipImageSpec
from freerein.learning.model_files import save_model
from freerein.model_store import ModelStore
from freerein_imitation.export import export_policy
from freerein_imitation.methods import METHODS
from freerein_imitation.methods.shared.goal_images.recognizer import GoalRecognizerNetwork, GoalRecognizerSpec


def export(*words: str) -> tuple[int, str]:
    """Returns exit code and output of `freerein models export`."""
    result = CliRunner().invoke(app, ["models", "export", *words])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, result.output


def outputs(folder: Path, given: dict[str, Any]) -> dict[str, Any]:
    """Returns what an exported graph makes of inputs."""
    session = onnxruntime.InferenceSession(folder / "policy.onnx")
    return dict(zip([each.name for each in session.get_outputs()], session.run(None, given), strict=True))


def test_the_graph_of_a_run_acts_step_after_step_as_the_served_policy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FREEREIN_DATA_DIR", str(tmp_path))
    leave(tmp_path, make(recurrent=True, action_repeat=2))
    to = tmp_path / "exported"
    code, said = export(RUN, "--run", "--to", str(to))
    assert code == 0, said
    assert sorted(path.name for path in to.iterdir()) == ["README.txt", "card.json", "model.safetensors", "policy.onnx"]

    policy, card = METHODS.load(to, "cpu"), json.loads((to / "card.json").read_bytes())
    assert [each["name"] for each in card["onnx"]["inputs"]] == [
        "observation.images.front",
        "executed_actions",
        "state",
    ]
    assert (card["task"], card["onnx"]["goals"]) == (CARD["task"], [CARD["goal_text"]])
    state, executed = np.zeros((3, policy.spec.recurrent_size), np.float32), np.zeros((3, 3), np.float32)
    for frame in FRAMES:
        seen = np.stack([frame[:, ::-1], frame[::-1], frame // 2])
        expected = policy.step({"front": seen}, np.zeros((3, 0), np.float32), executed, state)
        found = outputs(to, {"observation.images.front": seen, "executed_actions": executed, "state": state})
        np.testing.assert_allclose(found["actions"], expected.actions, atol=1e-4)
        np.testing.assert_allclose(found["in_distribution"], expected.in_distribution, atol=1e-4)
        np.testing.assert_allclose(found["next_state"], expected.recurrent, atol=1e-4)
        state, executed = expected.recurrent, expected.actions[:, 0]
    assert expected.in_distribution.max() > 0.1

    readme = (to / "README.txt").read_text().splitlines()
    assert len(readme) <= 15
    program = "\n".join(readme[3:]).replace("while True", "for frame in frames").replace("...", "frame", 1)
    monkeypatch.chdir(to)
    ran: dict[str, Any] = {"frames": FRAMES}
    exec(program, ran)
    assert ran["action"].shape == (3,)


@pytest.mark.long
def test_a_policy_that_sees_by_an_object_encoder_is_exported(tmp_path: Path) -> None:
    image = ClipImageSpec(phrases=2, at_peaks=True)
    leave(tmp_path, make(recurrent=False, eye=ObjectEncoderSpec(image, pushed=True)))
    export_policy(tmp_path / "runs" / RUN / "artifacts", tmp_path / "exported", data="")  # checks the graph
    assert (tmp_path / "exported" / "policy.onnx").exists()


@pytest.mark.long
@pytest.mark.parametrize("name", ["goals-two-cameras", "goal-cloning-discrete", "skills", "cloned-robot-state"])
def test_policies_of_other_goals_are_exported_and_checked(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FREEREIN_DATA_DIR", str(tmp_path))
    case, model, to = CASES[name], tmp_path / "model", tmp_path / "exported"
    publish(tmp_path, model, case.network, method=case.method)
    code, said = export("mine", "--to", str(to))
    assert code == 0, said
    card = json.loads((to / "card.json").read_bytes())["onnx"]
    given = {each["name"]: np.full((2, *each["shape"]), each["start"], each["dtype"]) for each in card["inputs"]}
    found = outputs(to, given)
    assert [each["name"] for each in card["outputs"]] == list(found)
    assert [(list(each.shape), str(each.dtype)) for each in found.values()] == [
        ([2, *each["shape"]], each["dtype"]) for each in card["outputs"]
    ]
    assert ("goal" in given) == (case.spec.__class__.__name__.startswith("Skill"))


def publish(data_dir: Path, folder: Path, network: Callable[[], Any], *, method: str) -> None:
    """Publishes an untrained network as the active version of the model `mine`."""
    folder.mkdir()
    control = {"control_dt_s": 0.04, "reached_threshold": 0.9, "max_steps_per_goal": 30}
    save_model(network(), folder, card={"method": method, "control": control})
    store = ModelStore(data_dir / "models" / "imitation")
    store.activate(store.publish("mine", folder))


def test_a_policy_that_is_no_graph_is_refused_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FREEREIN_DATA_DIR", str(tmp_path))
    spec = GoalRecognizerSpec(**INPUTS, embedding_size=8)
    publish(tmp_path, tmp_path / "model", lambda: GoalRecognizerNetwork(spec), method="goal_recognizer")
    code, said = export("mine", "--to", str(tmp_path / "exported"), "--json")
    assert (code, json.loads(said)["error"]["code"]) == (1, "unimplemented")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["models"]


def test_what_cannot_be_exported_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FREEREIN_DATA_DIR", str(tmp_path))
    full, new = tmp_path / "full", tmp_path / "new"
    full.mkdir()
    (full / "mine.txt").touch()
    for words, sentence in (
        (("skills", "--to", str(full)), "must be new or empty"),
        (("nothing", "--to", str(new)), "`nothing` is none that is active"),
        (("skills@000000000000", "--to", str(new)), "none has that name and version"),
        (("skills", "--to", str(new), "--goal-text", "up"), "this one follows recipe"),
        ((RUN, "--run", "--to", str(new)), "The run must exist"),
    ):
        code, said = export(*words)
        assert code == 1
        assert sentence in said
    assert [path.name for path in tmp_path.iterdir()] == ["full"]
