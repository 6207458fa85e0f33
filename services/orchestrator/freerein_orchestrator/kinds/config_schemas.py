"""JSON schemas of the configurations of runs."""

from collections.abc import Mapping
from typing import Any

from freerein.learning.config_schema import config_schema
from freerein_orchestrator.kinds.collect.config import CollectConfig
from freerein_orchestrator.kinds.distill import DistillConfig
from freerein_orchestrator.kinds.evaluate import FORMS
from freerein_orchestrator.kinds.fit import FitRunConfig
from freerein_orchestrator.kinds.label import LabelConfig
from freerein_orchestrator.kinds.pipeline import PipelineConfig
from freerein_orchestrator.kinds.ppo import PPORunConfig
from freerein_orchestrator.kinds.skills import SkillsRunConfig

CONFIGS: Mapping[str, type] = {
    "collect": CollectConfig,
    "distill": DistillConfig,
    **{f"evaluate {name}": form.config for name, form in FORMS.items()},
    "fit": FitRunConfig,
    "label": LabelConfig,
    "pipeline": PipelineConfig,
    "ppo": PPORunConfig,
    "skills": SkillsRunConfig,
}
"""Dataclasses of the configurations by kind, of evaluations by kind and form."""


def run_config_schema() -> dict[str, Any]:
    """Returns the JSON schema of `config` of a run; its alternatives are called as their kinds are."""
    return {"anyOf": [config_schema(config, title=title) for title, config in CONFIGS.items()]}
