"""Table 2.1: the grid world with its indicator, {objectives} x {contexts}, and the supervised ceiling."""

from experiments.segmentation.dataset import DatasetSpec, SplitSpec
from experiments.segmentation.experiment import SegmentationExperiment
from experiments.segmentation.report import Report, Row

_TRAIN, _STEPS, _BATCH_SIZE, _LR, _TRAIN_EVALUATED = 50_000, 150, 128, 2e-3, 2_000

_TEXT = f"""\
Frame accuracy, in per cent of timesteps. Data as in section 2.3: 50 000 training trajectories of 2 to 4 skills, 2 000
for validation, 1 000 for test with 5 skills; training accuracy is measured on the first {_TRAIN_EVALUATED}.

All rows share network, loop, batch size ({_BATCH_SIZE} trajectories), optimiser steps ({_STEPS}) and peak learning rate
({_LR:g}), and differ in objective and context. The dissertation's are `lse` and `mil` with the causal context; it has a
learning rate of 1e-4 and gives no number of steps. Ours is the library's default, and no other was tried; the number of
steps was set by the time at hand. The weights of the lowest validation loss are evaluated: the loss of tags, and for
`supervised` that of true labels.

`random` guesses a skill for each timestep, `random_cls` one of the trajectory's skills (36 when averaged over
trajectories, as the dissertation prints), `majority` always the trajectory's longest skill.

`gap closed` is (value - lse causal) / (supervised in the same context - lse causal), where that gap is at least half a
point. Intervals are by bootstrap over seeds, then over trajectories. With one seed, and for guesses, they are over
trajectories only, and say nothing about other seeds.
"""

EXPERIMENT = SegmentationExperiment(
    data=DatasetSpec(
        "grid", train=SplitSpec(_TRAIN, 2, 4), validation=SplitSpec(2_000, 2, 4), test=SplitSpec(1_000, 5, 5)
    ),
    objectives=("lse", "lse_per_timestep", "mil"),
    contexts=("causal", "bidirectional"),
    seeds=3,
    settings={
        "steps": _STEPS,
        "batch_size": _BATCH_SIZE,
        "lr": _LR,
        "augmentation": 0.0,
        "evaluate_every": 25,
        "checkpoint_every": 25,
    },
    train_evaluated=_TRAIN_EVALUATED,
    report=Report(
        "grid",
        title="The grid world (Table 2.1)",
        text=_TEXT.strip(),
        dissertation_trajectories=_TRAIN,
        dissertation={
            Row("random"): (20, 20, 20),
            Row("random_cls"): (36, 36, 20),
            Row("lse", "causal"): (100, 100, 100),
            Row("mil", "causal"): (90.78, 91.08, 91.08),
        },
    ),
)
