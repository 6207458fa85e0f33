"""Table 2.2: the robot arms of the worlds `dial` and `bins`."""

from experiments.segmentation.dataset import DatasetSpec, SplitSpec
from experiments.segmentation.evaluation import CONFIDENT_ACCURACY
from experiments.segmentation.experiment import SegmentationExperiment
from experiments.segmentation.methods import (
    CAUSAL,
    LEARNING_RATES,
    LOOKAHEAD,
    OURS,
    OURS_FROM_LSE,
    WHOLE,
    lse_as_published,
    objectives,
    ours,
    ours_after,
    ours_from_lse,
    repeated,
    supervised,
)
from experiments.segmentation.report import Report
from experiments.segmentation.rows import Row, dissertation
from experiments.segmentation.study import Study
from experiments.segmentation.targets import Target
from experiments.workbench.table import words

DIAL, BINS = "dial", "bins"
_OURS = (
    Row(OURS, WHOLE),
    Row(OURS_FROM_LSE, WHOLE),
    Row(OURS, LOOKAHEAD),
    *(Row(ours_after(context).name, WHOLE) for context in (CAUSAL, LOOKAHEAD, "lookahead-10")),
)
_TRAIN = {DIAL: 2_000, BINS: 1_000}
_STEPS, _TRIAL_STEPS = 4_000, 1_000
_BATCH_SIZE, _STRIDE, _TRAIN_EVALUATED = 16, 3, 500


_BASELINES = (
    *objectives("lse_per_timestep", contexts=(WHOLE,)),
    *objectives("mil", "fcn_mil", "ccnn", "ccnn_without_share", contexts=(CAUSAL,)),
)
_METHODS = {
    DIAL: (
        *objectives("lse", contexts=(CAUSAL, WHOLE)),
        *repeated(1, lse_as_published()),
        ours(WHOLE),
        *repeated(1, ours_from_lse(), ours_after(LOOKAHEAD)),
        supervised(WHOLE),
        *repeated(1, *_BASELINES),
    ),
    BINS: (
        *objectives("lse", contexts=(CAUSAL, LOOKAHEAD)),
        *repeated(2, *objectives("lse", contexts=(WHOLE,))),
        *repeated(1, lse_as_published(), ours(WHOLE)),
        ours(LOOKAHEAD),
        *repeated(1, ours_from_lse(), ours_after(CAUSAL)),
        ours_after(LOOKAHEAD),
        ours_after("lookahead-10"),
        supervised(WHOLE, LOOKAHEAD),
        *repeated(1, *_BASELINES),
    ),
}


def _study(task: str, *, least: int, most: int, test: int) -> Study:
    return Study(
        data=DatasetSpec(
            task,
            train=SplitSpec(_TRAIN[task], least, most),
            validation=SplitSpec(200, least, most),
            test=SplitSpec(200, test, test),
        ),
        methods=_METHODS[task],
        seeds=3,
        settings={
            "steps": _STEPS,
            "batch_size": _BATCH_SIZE,
            "stride": _STRIDE,
            "augmentation": 0.0,
            "evaluate_every": 200,
            "checkpoint_every": 200,
        },
        train_evaluated=_TRAIN_EVALUATED,
        learning_rates=LEARNING_RATES,
        trial_steps=_TRIAL_STEPS,
    )


EXPERIMENT = SegmentationExperiment(
    studies=(_study(DIAL, least=2, most=4, test=5), _study(BINS, least=3, most=3, test=4)),
    report=Report(
        "table_2_2",
        title="Robot arms (Table 2.2)",
        text=words("table_2_2"),
        dissertation_trajectories=_TRAIN,
        dissertation=dissertation("table_2_2"),
        targets=(
            Target("dial", DIAL, _OURS, least_gap_closed=0.75, above=59.93),
            Target("bins", BINS, _OURS, least_gap_closed=0.75, above=33.88),
            Target(
                "dial_kept",
                DIAL,
                _OURS,
                figure=f"validation.{CONFIDENT_ACCURACY}",
                least=95.0,
                least_figures={"validation.confident_kept_share": 0.8, "validation.confident_least_kept_share": 0.5},
            ),
        ),
    ),
    sources=("development",),
)
