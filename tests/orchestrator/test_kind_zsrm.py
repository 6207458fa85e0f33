"""Runs of kind `zsrm`, with the real sim, reward and imitation services."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tests.own_world import install_template

from freerein.clients import Channel, ImitationClient, SyncClient
from freerein.errors import InvalidInput
from freerein.types.common import ActionSpec, Camera
from freerein.types.imitation import GetSpecRequest
from freerein.types.sim import Task
from freerein_orchestrator.kinds import KINDS
from freerein_orchestrator.kinds.zsrm import ZsrmRunConfig, pipeline_steps

TEXT = "a red block to the left of a blue block"
LEFT = {"camera": "left", "height": 64, "width": 64}
CAMERAS = Camera("front", 64, 64, 3), Camera("left", 48, 64, 3)
TASK = Task("blocks.yellow-left-of-green", "blocks", "put it there", CAMERAS, ActionSpec(3, 0, ("x",)), 0.1, (), 100)


def test_the_texts_two_things_are_the_phrases_of_the_reward_that_the_policy_learns_from() -> None:
    config = ZsrmRunConfig(TASK.name, TEXT, phrases=("a green block", "a red block"), policy=LEFT, seed=3)
    images, reward, policy = (each["config"] for each in pipeline_steps(config, TASK, "blocks.scatter"))
    assert (images["task"], images["behaviour"], images["cameras"]) == ("blocks.scatter", "random", ["left"])
    assert (images["height"], images["width"]) == (policy["height"], policy["width"]) == (64, 64)
    assert reward["config"]["phrases"] == ["a red block", "a blue block", "a green block"]
    assert policy["reward_model"] == reward["model_name"] == f"{TASK.name}-zsrm"
    assert (policy["goal_text"], policy["seed"], reward["config"]["seed"]) == (TEXT, 3, 3)
    KINDS["pipeline"].parse({"steps": pipeline_steps(config, TASK, "blocks.scatter")})


@pytest.mark.parametrize(
    ("wrong", "field"),
    [
        ({"text": "stack everything"}, "config.text"),
        ({"text": "a cup apart from a box", "reward": {"method": "criterion_captions"}}, "config.text"),
        ({"policy": {"batch_size": 7}}, "config.batch_size"),
        ({"policy": {"reward": "oracle"}}, "config.policy"),
        ({"reward": {"steps": -1}}, "config"),
        ({"reward": {"phrases": ["a cup"]}}, "config.reward"),
        ({"name": "../a"}, "config.name"),
    ],
)
def test_what_cannot_be_learned_from_is_refused_before_anything_is_done(wrong: dict[str, Any], field: str) -> None:
    with pytest.raises(InvalidInput) as refused:
        KINDS["zsrm"].parse({"task": TASK.name, **wrong})
    assert refused.value.field.startswith(field)


@pytest.mark.parametrize(
    ("text", "policy", "views", "encoder"),
    [
        ("put a blue puck near a yellow puck", {}, ["front", "", "front"], "goal_eye"),
        ("put a blue puck near a yellow puck", {"gray": True}, ["front", "", "front"], "spatial"),
        ("a blue puck behind a yellow puck", {"camera": "left"}, ["left", "left", ""], "spatial"),
        ("a blue puck behind a yellow puck", {"cameras": ["front", "left"]}, None, "spatial"),
    ],
)
def test_what_no_relation_says_is_judged_by_criteria(
    text: str, policy: dict[str, Any], views: list[str] | None, encoder: str
) -> None:
    task = replace(TASK, name="push")
    images, reward, training = pipeline_steps(ZsrmRunConfig(task.name, text, policy=policy), task, "push.scatter")
    assert reward["config"]["config"]["method"] == "criterion_captions"
    assert reward["config"]["config"]["phrases"] == ["a blue puck", "a yellow puck"]
    assert reward["config"]["config"].get("views") == views
    assert reward["config"]["config"]["cameras"] == policy.get("cameras", [policy.get("camera", "front")])
    assert (training["config"]["encoder"], images["config"]["task"]) == (encoder, "push.scatter")


@pytest.mark.parametrize("policy", [{"camera": "left"}, {"height": 32, "width": 32}])
def test_an_object_encoder_that_would_see_other_sizes_than_the_reward_model_is_refused_first(
    policy: dict[str, Any],
) -> None:
    with pytest.raises(InvalidInput, match="64 x 64; those of the training are") as refused:
        pipeline_steps(ZsrmRunConfig(TASK.name, TEXT, policy=policy), TASK, "blocks.scatter")
    assert refused.value.field == "config.policy"
    pipeline_steps(ZsrmRunConfig(TASK.name, TEXT, policy=policy | {"encoder": "spatial"}), TASK, "blocks.scatter")


def test_a_task_whose_own_goal_states_nothing_needs_a_text() -> None:
    with pytest.raises(
        InvalidInput, match="must state a relation or criterion of two or three things; got `put it there`"
    ):
        pipeline_steps(ZsrmRunConfig(TASK.name), TASK, TASK.name)


@pytest.mark.long  # two fits of a reward model, and of an object encoder
@pytest.mark.e2e
@pytest.mark.parametrize(
    ("task", "text"),
    [
        ("blocks.red-left-of-blue", TEXT),
        ("push", "a blue object close to a yellow object"),
        ("lamps", "a red object to the left of a blue object"),  # of a package that is installed
    ],
)
def test_a_run_goes_from_a_text_to_a_policy_that_is_served_the_same_where_it_is_stopped_between(
    task: str, text: str, new_run: Callable[..., Any], start_service: Callable[..., Any], tmp_path: Path
) -> None:
    installed = tmp_path / "installed"
    installed.mkdir()
    install_template(installed)
    started = {
        name: start_service(f"freerein_{name.lower()}", tmp_path, FREEREIN_SIM_WORKERS="1", PYTHONPATH=str(installed))
        for name in ("SIM", "REWARD", "IMITATION")
    }
    services = {f"FREEREIN_{name}_ADDRESS": service.address for name, service in started.items()}
    config = {
        "task": task,
        "text": text,
        "count": 60,
        "name": "words",
        "reward": {"steps": 20},
        "policy": {"iterations": 1, "explorations": 2, "num_steps": 32, "num_envs": 2, "batch_size": 16},
    }
    run = new_run(tmp_path, "zsrm", config, **services)
    fitted = run.folder / "parts" / "reward" / "done.json"
    assert not run.do(stop=fitted.exists)
    recorded = fitted.stat().st_mtime_ns

    assert run.do()

    assert fitted.stat().st_mtime_ns == recorded
    assert run.rows[-1]["step"] == run.kind.steps(run.config) == 60 + 20 + 1
    result = run.artifact("result.json")
    assert (result["goal_text"], result["privileged"]) == (text, False)
    assert result["models"]["policy"] == vars(run.model)
    assert (result["models"]["reward"]["name"], run.model.name) == ("words", "words")
    with SyncClient(ImitationClient(Channel(started["IMITATION"].address))) as imitation:
        assert imitation.get_spec(GetSpecRequest(run.model)).goal_texts == (text,)

    undisturbed = new_run(tmp_path, "zsrm", config | {"name": "again"}, **services)
    assert undisturbed.do()
    folders = [tmp_path / "models/imitation" / each.model.name / each.model.version for each in (run, undisturbed)]
    stopped, whole = ((folder / "model.safetensors").read_bytes() for folder in folders)
    assert stopped == whole
