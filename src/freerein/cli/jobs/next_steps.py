"""The commands that follow a fit or run that has succeeded, with its own names filled in."""

from collections.abc import Mapping, Sequence
from typing import Any

import typer

from freerein.cli.jobs.ids import short
from freerein.types.common import ModelRef
from freerein.types.learning import Fit
from freerein.types.orchestrator import Run

_GOALS = {"skills": "--recipe SKILL", "skill_cloning": "--recipe SKILL", "language": "--goal-text 'TEXT'"}
"""How a model of the imitation service is given its goal, by its method; a goal image by default."""


def say_next_steps(commands: Sequence[str]) -> None:
    """Prints commands on stderr, beside the job itself on stdout."""
    typer.echo("\n".join(["What next:", *(f"  {command}" for command in commands)]), err=True)


def next_steps(service: str, job: Fit | Run) -> list[str]:
    """Returns commands for what a job of a service has made."""
    if isinstance(job, Run):
        return _after_run(job)
    return _with_model(service, job.model or ModelRef(job.model_name), job.dataset, job.config)


def _after_run(run: Run) -> list[str]:
    config, run_id = run.config, short(run.id)
    match run.kind:
        case "ppo":
            return [
                _evaluate(str(config["task"]), f'{{"run": "{run_id}"}}'),
                f"freerein jobs resume {run_id} --iterations {config['iterations']} --watch  # trains it on",
                f"freerein models publish {run_id} --name NAME  # serves it by name",
                f"freerein jobs artifacts {run_id} policy.mp4  # shows what it does",
            ]
        case "collect":
            name = config["dataset"]
            return [f"freerein dataset check {name}", f"freerein fit segmentation {name} --watch"]
        case "label":
            return [f"freerein fit imitation {config['dataset']} --set method=skill_cloning --watch"]
        case "fit":
            model = run.model or ModelRef(str(config["model_name"]))
            return _with_model(str(config["service"]), model, str(config["dataset"]), dict(config["config"]))
        case "distill" | "zsrm":
            name = config["model_name" if run.kind == "distill" else "name"]
            return [f"freerein act --model {name} --image IMAGE.png --goal-text 'TEXT'"]
        case _:
            return [f"freerein jobs artifacts {run_id}  # what it has made"]


def _with_model(service: str, model: ModelRef, dataset: str, config: Mapping[str, Any]) -> list[str]:
    match service:
        case "segmentation":
            return [
                f"freerein segment {dataset} --model {model.name}",
                f"freerein run label --set dataset={dataset} --set model={model.name} --watch  # all of it",
            ]
        case "imitation":
            goal = _GOALS.get(str(config.get("method")), "--goal GOAL.png")
            return [f"freerein act --model {model.name} --image IMAGE.png {goal}"]
        case _:
            cameras = tuple(config.get("cameras", ()))
            several = len(cameras) > 1
            images = " ".join(f"{camera}=IMAGE.png" for camera in cameras) if several else "IMAGE.png"
            audit = f"freerein reward --audit DIR --model {model.name}  # self-consistency only, so far"
            return [
                f"freerein reward {images} --goal 'TEXT' --model {model.name}",
                *[audit] * (not several),
                f"freerein run ppo --set task=TASK --set reward_model={model.name} --watch  # learns from it",
            ]


def _evaluate(task: str, policy: str) -> str:
    return f"freerein run evaluate --set task={task} --set 'policy={policy}' --watch"
