"""What ours is chosen from: objectives, and what may follow them, in the development world `blocks`."""

from experiments.segmentation.dataset import DatasetSpec, SplitSpec
from experiments.segmentation.experiment import SegmentationExperiment
from experiments.segmentation.methods import (
    CAUSAL,
    CHOSEN,
    LOOKAHEAD,
    WHOLE,
    objectives,
    ours,
    ours_after,
    ours_from_lse,
    repeated,
    supervised,
)
from experiments.segmentation.report import Report
from experiments.segmentation.study import Method, Study
from experiments.workbench.table import words
from freerein.learning.checkpoints import JSON

_STEPS, _TRIAL_STEPS, _BATCH_SIZE = 1_600, 400, 16
_LEARNING_RATES = (1.5e-3, 5e-3, 1.5e-2)


def _then(name: str, objective: str, **settings: JSON) -> Method:
    return Method(name, (WHOLE,), {"objective": "lse_per_timestep", "final_objective": objective, **settings})


EXPERIMENT = SegmentationExperiment(
    studies=(
        Study(
            data=DatasetSpec(
                "blocks", train=SplitSpec(800, 2, 3), validation=SplitSpec(100, 2, 3), test=SplitSpec(100, 4, 4)
            ),
            methods=(
                *repeated(2, ours(), ours_from_lse()),
                *repeated(1, ours_after(CAUSAL)),
                *repeated(2, ours_after(LOOKAHEAD)),
                ours_after("lookahead-10"),
                *repeated(2, _then("self_training", "self_training")),
                _then(CHOSEN, CHOSEN),
                *repeated(2, *objectives("lse_per_timestep", contexts=(WHOLE,))),
                *repeated(1, supervised(WHOLE), *objectives("lse", "mil", "fcn_mil", "ccnn", contexts=(CAUSAL,))),
            ),
            seeds=3,
            settings={
                "steps": _STEPS,
                "warmup_steps": 300,
                "batch_size": _BATCH_SIZE,
                "stride": 2,
                "augmentation": 0.0,
                "evaluate_every": 100,
                "checkpoint_every": 100,
            },
            train_evaluated=200,
            guesses=("random", "random_cls", "majority", "equal_parts", "truth"),
            learning_rates=_LEARNING_RATES,
            trial_steps=_TRIAL_STEPS,
        ),
    ),
    report=Report("development", title="The development world", text=words("development")),
)
