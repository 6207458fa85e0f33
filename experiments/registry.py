"""The experiments by name."""

import importlib
import sys
from pathlib import Path

from experiments.workbench import results
from experiments.workbench.arms import Experiment, is_current
from experiments.workbench.results import ArmResult
from freerein.errors import NotFound, quoted

EXPERIMENTS = (
    "development",
    "confirmation",
    "table_2_1",
    "table_2_2",
    "table_2_3",
    "table_2_4",
    "fig_2_3",
    "robustness",
    "teachers",
    "table_4_2",
    "fig_4_3",
    "fig_4_4",
    "fig_4_5",
    "fig_4_6",
    "criteria",
    "first_session",
    "demo",
    "doom",
    "office",
    "rope",
    "smoke",
)
"""Names of the experiments; each is a module of this package with the attribute `EXPERIMENT`."""


def load(name: str) -> Experiment:
    """Returns the experiment of a name; NotFound for an unknown one."""
    if name not in EXPERIMENTS:
        raise NotFound(f"The experiment must be one of {', '.join(EXPERIMENTS)}; got {quoted(name)}.", field="name")
    experiment: Experiment = importlib.import_module(f"experiments.{name}").EXPERIMENT
    return experiment


def load_current(folder: Path, pattern: str = "*") -> list[ArmResult]:
    """Returns the results in an experiment's folder that its present arms would not replace.

    Others are named on standard error. `pattern` is a shell pattern of the results' names.
    """
    experiment = load(folder.name)
    arms = {arm.name: arm for arm in experiment.arms}
    current = []
    for result in results.load_all(folder, pattern):
        if result.name in arms and is_current(experiment, arms[result.name], result):
            current.append(result)
        else:
            print(f"{result.name} is left out: another configuration or another world made it.", file=sys.stderr)
    return current
