"""Runs of kind `skills`, with the real sim, segmentation and imitation services."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from freerein.data import dataset_path, labels
from freerein.errors import InvalidInput
from freerein.types.common import ActionSpec
from freerein.types.sim import Task
from freerein_orchestrator.kinds import KINDS
from freerein_orchestrator.kinds.skills import SkillsRunConfig, pipeline_steps

SMALL = {"batch_size": 2, "features": 8, "hidden_size": 8, "log_every": 1}
CONFIG = {
    "task": "grid",
    "count": 4,
    "segmentation": {**SMALL, "steps": 2},
    "policies": {**SMALL, "steps": 2, "min_segment_steps": 1},
    "episodes": 2,
    "num_envs": 2,
}
TASK = Task(
    "dial",
    "dial",
    "",
    (),
    ActionSpec(1, 0, ("torque",)),
    0.04,
    tuple(f"press-{digit}" for digit in range(10)),
    100,
    has_expert=True,
    min_skills=1,
    max_skills=5,
)


def test_demonstrations_have_fewer_skills_than_the_recipes_that_are_executed() -> None:
    demos, *_, recipes, _ = pipeline_steps(SkillsRunConfig("dial"), TASK)
    assert (demos["config"]["min_skills"], demos["config"]["max_skills"]) == (2, 4)
    assert (recipes["config"]["skills_per_recipe"], recipes["config"]["episode_steps"]) == (0, 200)
    fixed, *_ = pipeline_steps(SkillsRunConfig("dial"), replace(TASK, min_skills=2, max_skills=2))
    assert (fixed["config"]["min_skills"], fixed["config"]["max_skills"]) == (2, 2)
    KINDS["pipeline"].parse({"steps": pipeline_steps(SkillsRunConfig("dial", policies={"ends": "budget"}), TASK)})


@pytest.mark.parametrize("number", [1, 6])
def test_recipes_that_the_task_has_none_of_are_refused_before_anything_is_done(number: int) -> None:
    with pytest.raises(InvalidInput, match=f"must be 2 to 5, as long as the task's recipes, or 0; got {number}"):
        pipeline_steps(SkillsRunConfig("dial", skills_per_recipe=number), replace(TASK, min_skills=2))


@pytest.mark.parametrize("lacking", [{"skills": ()}, {"has_expert": False}])
def test_a_task_without_skills_or_expert_is_refused(lacking: dict[str, Any]) -> None:
    with pytest.raises(InvalidInput, match="a task with skills and an expert"):
        pipeline_steps(SkillsRunConfig("dial"), replace(TASK, **lacking))


@pytest.mark.e2e
def test_a_run_goes_from_demonstrations_to_recipes_though_it_is_stopped_between(
    new_run: Callable[..., Any], start_service: Callable[..., Any], tmp_path: Path
) -> None:
    services = {
        f"FREEREIN_{name}_ADDRESS": start_service(
            f"freerein_{name.lower()}", tmp_path, FREEREIN_SHIPPED_DIR="none", FREEREIN_SIM_WORKERS="1"
        ).address
        for name in ("SIM", "SEGMENTATION", "IMITATION")
    }
    run = new_run(tmp_path, "skills", CONFIG, **services)
    segmented = run.folder / "parts" / "segmentation" / "done.json"
    assert not run.do(stop=segmented.exists)
    recorded = segmented.stat().st_mtime_ns

    assert run.do()

    assert segmented.stat().st_mtime_ns == recorded
    steps = [row["name"] for row in run.artifact("steps.json")]
    assert steps == ["demos", "segmentation", "label", "policies", "recipes", "expert"]
    assert run.rows[-1]["step"] == run.kind.steps(run.config) == 2 * 4 + 2 + 2 + 2 * 2
    result = run.artifact("result.json")
    assert (result["demonstrations"], result["counts"]["episodes"]) == (4, 2)
    assert result["models"]["segmentation"] == vars(labels.info(dataset_path(tmp_path, "grid-skills")).model)
    assert result["models"]["policies"] == vars(run.model)
    for name in ("subtask_success", "recipe_success"):
        figure = result["figures"][name]
        assert 0 <= figure["low"] <= figure["value"] <= figure["high"] <= 1
        assert figure["expert"] == 1
        assert figure["random"] < 1
