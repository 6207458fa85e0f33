"""Table 2.4: the world `tabletop`, a procedural substitute for MIME's protocol, and its variant of own objects only."""

from experiments.segmentation.dataset import DatasetSpec, SplitSpec
from experiments.segmentation.experiment import SegmentationExperiment
from experiments.segmentation.methods import (
    CAUSAL,
    LEARNING_RATES,
    LOOKAHEAD,
    OURS,
    WHOLE,
    objectives,
    ours,
    ours_after,
    repeated,
    supervised,
)
from experiments.segmentation.report import Report
from experiments.segmentation.rows import Row
from experiments.segmentation.study import Method, Study
from experiments.segmentation.targets import Target
from experiments.workbench.table import words

TABLETOP, OWN_OBJECTS = "tabletop", "tabletop.only-own-objects"
_TRAIN, _BATCH_SIZE, _STRIDE, _TRAIN_EVALUATED = 1_600, 16, 3, 500
_TEST, _LOOKED_AT = 1_000, 200
_STEPS, _TRIAL_STEPS = 3_000, 750
_FIXED_SPLIT = "fixed_split"
_OURS_AFTER = ours_after(CAUSAL)
_OURS = (
    *(Row(OURS, context) for context in (WHOLE, LOOKAHEAD, CAUSAL)),
    Row(_OURS_AFTER.name, WHOLE),
)


_METHODS = (*objectives("lse", contexts=(CAUSAL,)), _OURS_AFTER)
_METHODS_OF_TABLETOP = (
    *objectives("lse", contexts=(CAUSAL,)),
    *repeated(1, ours(WHOLE, LOOKAHEAD, CAUSAL)),
    _OURS_AFTER,
    supervised(WHOLE),
    *repeated(1, supervised(LOOKAHEAD, CAUSAL), *objectives("lse_per_timestep", contexts=(WHOLE,))),
    *repeated(1, *objectives("mil", "fcn_mil", "ccnn", "ccnn_without_share", contexts=(CAUSAL,))),
)


def _study(task: str, *methods: Method, test: int, seeds: int) -> Study:
    return Study(
        data=DatasetSpec(
            task, train=SplitSpec(_TRAIN, 2, 2), validation=SplitSpec(200, 2, 2), test=SplitSpec(test, 2, 2)
        ),
        methods=methods,
        seeds=seeds,
        settings={
            "steps": _STEPS,
            "batch_size": _BATCH_SIZE,
            "stride": _STRIDE,
            "augmentation": 0.0,
            "evaluate_every": 200,
            "checkpoint_every": 200,
        },
        train_evaluated=_TRAIN_EVALUATED,
        guesses=("random", "random_cls", "majority", _FIXED_SPLIT),
        learning_rates=LEARNING_RATES,
        trial_steps=_TRIAL_STEPS,
    )


EXPERIMENT = SegmentationExperiment(
    studies=(
        _study(TABLETOP, *_METHODS_OF_TABLETOP, test=_TEST, seeds=5),
        _study(OWN_OBJECTS, *_METHODS, test=_LOOKED_AT, seeds=1),
    ),
    report=Report(
        "table_2_4",
        title="A substitute for MIME (Table 2.4)",
        text=words("table_2_4"),
        dissertation_trajectories={TABLETOP: _TRAIN, OWN_OBJECTS: _TRAIN},
        targets=(Target("tabletop", TABLETOP, _OURS, seeds=5, above_row=Row(_FIXED_SPLIT), first_trial=_LOOKED_AT),),
    ),
    sources=("development",),
)
