"""What every kind of run has in common."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

from freerein.errors import InvalidInput
from freerein_orchestrator.kinds import KINDS, find_kind
from freerein_orchestrator.kinds.config_schemas import run_config_schema
from freerein_orchestrator.kinds.policy_store import PolicyStore

TOLD = "8" * 32
MIX = {"task": "grid", "dataset": "play", "behaviour": "mix", "parts": [{"policy": TOLD}, {"policy": "random"}]}

FIT = {"service": "imitation", "dataset": "play", "config": {"steps": 30}}
CONFIGS: dict[str, tuple[dict[str, Any], int]] = {
    "collect": ({"task": "grid", "dataset": "play", "count": 7, "cameras": ["top"]}, 7),
    "fit": (FIT, 30),
    "label": ({"dataset": "play", "smoothing": 1}, 0),
    "ppo": ({"task": "grid", "iterations": 5.0, "reward": "oracle"}, 5),
    "distill": ({"teachers": ["left", "right"], "rollouts": 4, "config": {"steps": 9}}, 17),
    "evaluate": ({"task": "grid", "policy": {"run": "fit"}, "episodes": 3}, 3),
    "skills": ({"task": "grid", "count": 8, "episodes": 3, "policies": {"steps": 7}, "segmentation": {"steps": 5}}, 34),
    "zsrm": ({"task": "grid", "text": "a red cell on a blue cell", "count": 8, "policy": {"iterations": 3}}, 1011),
    "pipeline": ({"steps": [{"name": "fit", "kind": "fit", "config": FIT}]}, 30),
}


def test_the_table_of_kinds_is_that_of_the_docs() -> None:
    page = (Path(__file__).parents[2] / "docs" / "runs.md").read_text()
    assert set(KINDS) == set(CONFIGS)
    assert set(re.findall(r"^### (\w+)$", page, re.MULTILINE)) == set(KINDS)


def test_an_unknown_kind_is_refused_beside_the_known_ones_and_the_nearest() -> None:
    with pytest.raises(InvalidInput, match=r"one of collect, .* got `PPo1`; did you mean `ppo`\?") as refused:
        find_kind("PPo1")
    assert refused.value.field == "kind"


@pytest.mark.parametrize("kind", CONFIGS)
def test_a_configuration_survives_json_and_says_how_many_steps_there_are(kind: str) -> None:
    values, steps = CONFIGS[kind]
    config = KINDS[kind].parse(values)
    dumped = KINDS[kind].dump(config)
    assert KINDS[kind].parse(json.loads(json.dumps(dumped))) == config
    assert KINDS[kind].steps(config) == steps
    with pytest.raises(InvalidInput):
        KINDS[kind].parse({**values, "unknown": 1})


@pytest.mark.parametrize(
    ("kind", "values", "words"),
    [
        ("ppo", {"task": "grid"}, ""),
        ("ppo", {"task": "grid", "reward": "oracle"}, "true reward"),
        ("ppo", {"task": "grid", "reward": "vice", "dataset": "play"}, "chosen by true states"),
        ("evaluate", {"task": "grid", "policy": "random"}, "to measure"),
        ("skills", {"task": "grid"}, "to measure"),
        ("collect", {"task": "grid", "dataset": "play"}, ""),
        ("ppo", {"task": "grid", "init_from": TOLD}, "told the truth"),
        ("ppo", {"task": "grid", "resume_from": TOLD}, "told the truth"),
        ("ppo", {"task": "grid", "init_from": "deleted"}, ""),
        ("distill", {"teachers": ["deleted", TOLD]}, "told the truth"),
        ("collect", MIX, "told the truth"),
        ("zsrm", {"task": "grid", "policy": {"init_from": TOLD}}, "told the truth"),
    ],
)
def test_a_run_says_what_of_the_truth_it_is_told_in_a_pipeline_too(
    kind: str, values: dict[str, Any], words: str, tmp_path: Path
) -> None:
    card = tmp_path / "runs" / TOLD / "artifacts" / "policy.json"
    card.parent.mkdir(parents=True)
    card.write_text(json.dumps({"privileged": True, "supervision": "told the truth"}))
    store, chosen = PolicyStore.open(tmp_path, {}), KINDS[kind]
    told = chosen.truth(chosen.dump(chosen.parse(values)), store)
    assert (words in told, bool(told)) == (True, bool(words))
    steps = {"steps": [{"name": "one", "kind": kind, "config": values}]}
    if kind not in ("skills", "zsrm"):  # which are pipelines themselves
        assert KINDS["pipeline"].truth(steps, store) == told


@pytest.mark.parametrize(
    ("key", "value"), [("batch_size", 7), ("num_steps", 65_536), ("final_log_std", 1e9), ("final_log_std", -6.0)]
)
def test_hyperparameters_that_do_not_fit_are_refused_by_their_key(key: str, value: float) -> None:
    with pytest.raises(InvalidInput) as error:
        KINDS["ppo"].parse({"task": "grid", key: value})
    assert error.value.field == f"config.{key}"
    assert error.value.hint


def test_the_last_log_standard_deviation_may_be_learned() -> None:
    assert KINDS["ppo"].parse({"task": "grid", "final_log_std": None}).final_log_std is None


def test_the_configuration_of_every_kind_is_described() -> None:
    described = {each["title"]: each for each in run_config_schema()["anyOf"]}
    assert {title.partition(" ")[0] for title in described} == {*KINDS}
    assert all(each["description"].endswith(".") for each in described.values())
    assert described["collect"]["required"] == ["task", "dataset"]
    assert described["collect"]["properties"]["count"]["maximum"] == 1_000_000
    assert all(each["description"] for kind in described.values() for each in kind["properties"].values())
