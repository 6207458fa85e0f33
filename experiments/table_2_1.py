"""Table 2.1: the grid world with its indicator cell and without, {objectives} x {contexts} x {raw, decoded}."""

from experiments.segmentation.dataset import DatasetSpec, SplitSpec
from experiments.segmentation.experiment import SegmentationExperiment
from experiments.segmentation.methods import (
    CAUSAL,
    LEARNING_RATES,
    LOOKAHEAD,
    OURS,
    OURS_FROM_LSE,
    WHOLE,
    objectives,
    ours,
    ours_after,
    ours_from_lse,
    repeated,
    supervised,
)
from experiments.segmentation.report import Report
from experiments.segmentation.rows import Row, dissertation
from experiments.segmentation.study import Method, Study
from experiments.segmentation.targets import Target
from experiments.workbench.table import words

_TRAIN, _BATCH_SIZE, _TRAIN_EVALUATED = 50_000, 16, 2_000
_WITH_INDICATOR, _WITHOUT = "grid", "grid-no-indicator"
_OURS = (Row(OURS, WHOLE), Row(OURS_FROM_LSE, WHOLE))
_LOOKAHEADS = (LOOKAHEAD, "lookahead-10")
_OURS_AFTER = ours_after("lookahead-10")
_OURS_WITHOUT = (
    *_OURS,
    *(Row(method, context) for context in _LOOKAHEADS for method in (OURS, OURS_FROM_LSE)),
    Row(_OURS_AFTER.name, WHOLE),
)
_ENCODER = {_WITH_INDICATOR: "patch", _WITHOUT: "moments"}
_STEPS, _TRIAL_STEPS = 3_200, 800
_WARMUP_STEPS, _EVALUATE_EVERY = 300, 200


def _study(task: str, *best_of_ours: Method, lookaheads: tuple[str, ...] = ()) -> Study:
    return Study(
        data=DatasetSpec(
            task, train=SplitSpec(_TRAIN, 2, 4), validation=SplitSpec(2_000, 2, 4), test=SplitSpec(1_000, 5, 5)
        ),
        methods=(
            *objectives("lse", contexts=(CAUSAL,)),
            *repeated(1, *objectives("lse", contexts=(WHOLE, *lookaheads)), ours(WHOLE, *lookaheads)),
            *best_of_ours,
            supervised(WHOLE),
            *repeated(1, supervised(CAUSAL, *lookaheads)),
            *repeated(1, *objectives("lse_per_timestep", "mil", "fcn_mil", "ccnn", "ccnn_without_share")),
        ),
        seeds=3,
        settings={
            "steps": _STEPS,
            "warmup_steps": _WARMUP_STEPS,
            "batch_size": _BATCH_SIZE,
            "encoder": _ENCODER[task],
            "augmentation": 0.0,
            "evaluate_every": _EVALUATE_EVERY,
            "checkpoint_every": _EVALUATE_EVERY,
        },
        train_evaluated=_TRAIN_EVALUATED,
        learning_rates=LEARNING_RATES,
        trial_steps=_TRIAL_STEPS,
    )


EXPERIMENT = SegmentationExperiment(
    studies=(
        _study(_WITH_INDICATOR, ours_from_lse(WHOLE)),
        _study(_WITHOUT, *repeated(1, ours_from_lse(WHOLE, *_LOOKAHEADS)), _OURS_AFTER, lookaheads=_LOOKAHEADS),
    ),
    report=Report(
        "table_2_1",
        title="The grid world (Table 2.1)",
        text=words("table_2_1"),
        dissertation_trajectories=dict.fromkeys((_WITH_INDICATOR, _WITHOUT), _TRAIN),
        dissertation=dissertation("table_2_1"),
        targets=(
            Target("grid_indicator", _WITH_INDICATOR, _OURS, least=99.95),
            Target("grid_plain", _WITHOUT, _OURS_WITHOUT, least_gap_closed=0.75),
        ),
    ),
    sources=("development",),
)
