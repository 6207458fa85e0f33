"""Table 2.1: the grid world with its indicator cell and without, {objectives} x {contexts} x {raw, decoded}."""

from experiments.segmentation.dataset import DatasetSpec, SplitSpec
from experiments.segmentation.experiment import SegmentationExperiment
from experiments.segmentation.methods import LEARNING_RATES, WHOLE, methods
from experiments.segmentation.report import Report
from experiments.segmentation.rows import Row
from experiments.segmentation.study import SUPERVISED, Study
from experiments.segmentation.targets import Target

_TRAIN, _STEPS, _BATCH_SIZE, _TRAIN_EVALUATED = 50_000, 400, 128, 2_000
_WITH_INDICATOR, _WITHOUT = "grid", "grid-no-indicator"

_TEXT = f"""\
Frame accuracy, in per cent of timesteps. Data as in section 2.3: 50 000 training trajectories of 2 to 4 skills, 2 000
for validation, 1 000 for test with 5 skills; training accuracy is measured on the first {_TRAIN_EVALUATED}. In
`{_WITH_INDICATOR}` a cell shows which skill is in progress, as in the dissertation; in `{_WITHOUT}` nothing does.

All rows share network, loop, batch size ({_BATCH_SIZE} trajectories) and optimiser steps ({_STEPS}), and differ in
objective and context. Each tries the same four peak learning rates for a quarter of the steps; the lowest validation
loss, of the tags, and for `supervised` of true labels, chooses, and it chooses the weights that are evaluated. The
dissertation's method is `lse` with the causal context; it has a learning rate of 1e-4 and gives no number of steps.

`random` guesses a skill for each timestep, `random_cls` one of the trajectory's skills (36 when averaged over
trajectories, as the dissertation prints), `majority` always the trajectory's longest skill. `decoded` is after a
Gaussian filter over time and the merging of segments under 5 timesteps, which suits no world whose skills are shorter.

`gap closed` is (value - lse causal) / (supervised in the same context - lse causal), where that gap is at least half a
point. Intervals are by bootstrap over seeds, then over trajectories. With one seed, and for guesses, they are over
trajectories only, and say nothing about other seeds.
"""


def _study(task: str) -> Study:
    return Study(
        data=DatasetSpec(
            task, train=SplitSpec(_TRAIN, 2, 4), validation=SplitSpec(2_000, 2, 4), test=SplitSpec(1_000, 5, 5)
        ),
        methods=methods("lse", "lse_per_timestep", "mil", SUPERVISED),
        seeds=3,
        settings={
            "steps": _STEPS,
            "batch_size": _BATCH_SIZE,
            "augmentation": 0.0,
            "evaluate_every": 50,
            "checkpoint_every": 50,
        },
        train_evaluated=_TRAIN_EVALUATED,
        learning_rates=LEARNING_RATES,
        trial_steps=_STEPS // 4,
    )


EXPERIMENT = SegmentationExperiment(
    studies=(_study(_WITH_INDICATOR), _study(_WITHOUT)),
    report=Report(
        "table_2_1",
        title="The grid world (Table 2.1)",
        text=_TEXT.strip(),
        dissertation_trajectories=dict.fromkeys((_WITH_INDICATOR, _WITHOUT), _TRAIN),
        dissertation={
            _WITH_INDICATOR: {
                Row("random"): (20, 20, 20),
                Row("random_cls"): (36, 36, 20),
                Row("lse", "causal"): (100, 100, 100),
                Row("mil", "causal"): (90.78, 91.08, 91.08),
                Row("fcn_mil", "causal"): (91.28, 91.88, 91.58),
                Row("ccnn", "causal"): (65.27, 64.63, 60.24),
            }
        },
        targets=(
            Target("grid_indicator", _WITH_INDICATOR, Row("lse_per_timestep", WHOLE), least=99.95),
            Target("grid_plain", _WITHOUT, Row("lse_per_timestep", WHOLE), least_gap_closed=0.75),
        ),
    ),
)
