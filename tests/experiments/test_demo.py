"""The demo as an experiment: its table has what the demo printed."""

from typing import Any

from experiments.demo import EXPERIMENT
from experiments.workbench.configs import to_json
from experiments.workbench.results import ArmResult

from freerein.cli.demo.report import Figure, summary

FIGURES = [
    Figure("goal images reached", 0.86, "%", (0.72, 0.97), 0.11, "random actions"),
    Figure("timesteps as told, untrained", 0.0, "steps", None, 3.3, "random actions"),
]


def test_the_table_has_the_figures_as_the_demo_prints_them() -> None:
    (arm,) = EXPERIMENT.arms
    shown: Any = to_json(summary(FIGURES, seed=0, seconds={"ppo": 120.0}))
    result = ArmResult(arm.name, arm.world, arm.method, {}, 0, {}, "blocks-v1", {}, {}, 5.0, 1.0, {}, "run", shown)

    made = EXPERIMENT.table([result])

    assert made.sections[0].rows == tuple(each.cells for each in FIGURES)
    assert made.sections[1].rows == (("ppo", "120"),)
    assert [(each.claim, each.value, each.low) for each in made.claims] == [
        ("goal images reached", 0.86, 0.72),
        ("timesteps as told, untrained", 0.0, None),
    ]
    assert made.picture.draw().startswith(b"\x89PNG")
