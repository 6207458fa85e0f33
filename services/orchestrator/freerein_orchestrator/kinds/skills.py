"""Kind `skills`: from demonstrations with tags to policies that execute recipes longer than any demonstration.

It is a pipeline: demonstrations are collected, a segmentation model is fitted to their tags and labels their timesteps,
skill policies are cloned from the labelled segments, and they and the expert execute recipes.

<folder>/parts/, artifacts/     as of a pipeline, whose steps are demos, segmentation, label, policies, recipes, expert
         artifacts/result.json  how many skills and whole recipes succeed: policies, expert and random actions
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from freerein.atomic_files import write_atomic
from freerein.clients.tasks import find_task
from freerein.config import bounded, parse
from freerein.errors import InvalidInput, must_be
from freerein.types.common import check_name
from freerein.types.sim import Task
from freerein_orchestrator.kinds import evaluate
from freerein_orchestrator.kinds.context import RunContext
from freerein_orchestrator.kinds.evaluate.recipes import COMPLETED, WHOLE
from freerein_orchestrator.kinds.evaluate.record import RESULT
from freerein_orchestrator.kinds.fit import check_steps
from freerein_orchestrator.kinds.kind import Kind
from freerein_orchestrator.kinds.label import CARD as LABELS_CARD
from freerein_orchestrator.kinds.pipeline import Pipeline, make_step

_HELD_OUT_SEED = 1_000_000
"""Added to the seed for evaluations."""

_SLOWNESS = 2
"""Steps for a recipe relative to those of an episode: recipes are longer than demonstrations, policies slower than the
expert."""

_SEGMENTATION: Mapping[str, Any] = {"steps": 1200, "stride": 3, "augmentation": 0.0}
_POLICIES: Mapping[str, Any] = {"method": "skill_cloning", "steps": 5000}
_FIGURES = {"subtask_success": f"skills_{COMPLETED}", "recipe_success": WHOLE}


@dataclass(frozen=True)
class SkillsRunConfig:
    """Configuration of a run of kind `skills`.

    Attributes:
        task: The task's name; it must have skills and an expert.
        name: Name of the dataset and of both models; empty for the task's, with `-skills`.
        count: Demonstrations.
        min_skills: Fewest different skills per demonstration; 0 means 2, or as few as the task's recipes have.
        max_skills: Most different skills per demonstration; 0 means one less than the longest recipe of the task.
        smoothing: Standard deviation of the temporal Gaussian filter of labels, in timesteps; 0 for none.
        min_kept: Shortest labelled segment in timesteps that policies are cloned from, as in section 2.4.
        segmentation: Configuration of the segmentation model's fit.
        policies: Configuration of the policies' fit.
        skills_per_recipe: Skills of each recipe of the evaluation; 0 means those of the task's longest.
        episode_steps: Steps in which a recipe is to be executed; 0 means twice those of the task.
        episodes: Recipes of the evaluation.
        num_envs: Recipes executed at a time.
        seed: Seed of every random draw.

    Raises:
        InvalidInput: A name, or `steps` of a fit's configuration, is invalid.
    """

    task: str
    name: str = ""
    count: int = bounded(400, least=2, most=100_000)
    min_skills: int = bounded(0, least=0, most=1000)
    max_skills: int = bounded(0, least=0, most=1000)
    smoothing: float = bounded(1.0, least=0.0, most=100.0)
    min_kept: int = bounded(5, least=0, most=1000)
    segmentation: dict[str, Any] = field(default_factory=dict)
    policies: dict[str, Any] = field(default_factory=dict)
    skills_per_recipe: int = bounded(0, least=0, most=256)
    episode_steps: int = bounded(0, least=0, most=10_000)
    episodes: int = bounded(50, least=1, most=100_000)
    num_envs: int = bounded(25, least=1, most=64)
    seed: int = bounded(0, least=0, most=2**31 - 1 - _HELD_OUT_SEED)

    def __post_init__(self) -> None:
        check_name(self.shared_name, field="config.name" if self.name else "config.task")
        for fit in (self.segmentation, self.policies):
            check_steps(fit)

    @property
    def shared_name(self) -> str:
        """Name of the dataset and of both models."""
        return self.name or f"{self.task}-skills"

    @property
    def fits(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """Configurations of the segmentation model's and the policies' fit, with the defaults of this kind."""
        seed = {"seed": self.seed}
        return {**_SEGMENTATION, **seed, **self.segmentation}, {**_POLICIES, **seed, **self.policies}

    @property
    def steps(self) -> int:
        """Steps of all parts: demonstrations, which are recorded and labelled, updates and recipes."""
        return 2 * self.count + sum(int(fit["steps"]) for fit in self.fits) + 2 * self.episodes


def pipeline_steps(config: SkillsRunConfig, task: Task) -> list[dict[str, Any]]:
    """Returns the steps of the pipeline, in order.

    Raises:
        InvalidInput: The task has no skills, or no expert, or no recipes of so many skills.
    """
    if not (task.skills and task.has_expert):
        raise InvalidInput(
            f"Skills are learned from a task with skills and an expert; {task.name} lacks them.",
            field="config.task",
            hint="Choose another task: freerein sim tasks.",
        )
    if config.skills_per_recipe and not task.min_skills <= config.skills_per_recipe <= task.max_skills:
        rule = f"{task.min_skills} to {task.max_skills}, as long as the task's recipes, or 0"
        field = "config.skills_per_recipe"
        raise must_be("skills_per_recipe", rule, config.skills_per_recipe, field=field, hint="0 for the longest.")
    name, (segmentation, policies) = config.shared_name, config.fits
    most = config.max_skills or max(task.min_skills, task.max_skills - 1)
    fewest = config.min_skills or max(task.min_skills, min(2, most))
    recipes = {
        "form": "recipes",
        "task": task.name,
        "skills_per_recipe": config.skills_per_recipe,
        "step_limits": "own",
        "episode_steps": config.episode_steps or _SLOWNESS * task.max_episode_steps,
        "episodes": config.episodes,
        "num_envs": config.num_envs,
        "seed": config.seed + _HELD_OUT_SEED,
    }
    demos = {"count": config.count, "min_skills": fewest, "max_skills": most, "seed": config.seed}
    fit = {"dataset": name, "model_name": name}
    return [
        make_step("demos", "collect", task=task.name, dataset=name, **demos),
        make_step("segmentation", "fit", service="segmentation", config=segmentation, **fit),
        make_step("label", "label", dataset=name, model=name, smoothing=config.smoothing, min_kept=config.min_kept),
        make_step("policies", "fit", service="imitation", config=policies, **fit),
        make_step("recipes", "evaluate", policy={"run": "policies"}, **recipes),
        make_step("expert", "evaluate", policy="expert", **recipes),
    ]


def skills_kind(pipeline: Kind[Pipeline]) -> Kind[SkillsRunConfig]:
    """Returns the kind `skills`, which is done by the kind `pipeline`."""

    def run(context: RunContext, config: SkillsRunConfig) -> None:
        task = context.retry().call(lambda: find_task(context.client("sim"), config.task))
        pipeline.run(context, pipeline.parse({"steps": pipeline_steps(config, task)}))
        _write_result(context, task)

    def named(values: Mapping[str, Any]) -> SkillsRunConfig:
        config = parse(SkillsRunConfig, values)
        return replace(config, name=config.shared_name)

    return Kind(
        {"": SkillsRunConfig},
        named,
        steps=lambda config: config.steps,
        run=run,
        truth=evaluate.KIND.truth,
        meaning="Goes from demonstrations with tags to policies that execute recipes longer than any demonstration.",
    )


def _write_result(context: RunContext, task: Task) -> None:
    """Writes the figures of the evaluations side by side; random actions are the baseline of the policies'."""
    recipes, expert, labels = (
        json.loads((context.artifacts / name).read_bytes())
        for name in (f"recipes.{RESULT}", f"expert.{RESULT}", f"label.{LABELS_CARD}")
    )

    def compared(name: str) -> dict[str, Any]:
        own = recipes["figures"][name]
        return {
            "value": own["value"],
            "low": own["low"],
            "high": own["high"],
            "expert": expert["figures"][name]["value"],
            "random": own["baseline"],
        }

    document = {
        "task": task.name,
        "demonstrations": labels["trajectories"],
        "counts": recipes["counts"],
        "figures": {title: compared(name) for title, name in _FIGURES.items()},
        "models": {"segmentation": labels["model"], "policies": recipes["model"]},
        "privileged": True,
    }
    write_atomic(context.artifacts / RESULT, json.dumps(document, indent=2).encode() + b"\n")
