"""A tiny experiment that takes seconds, for tests; its figures mean nothing."""

from experiments.segmentation.dataset import DatasetSpec, SplitSpec
from experiments.segmentation.experiment import SegmentationExperiment
from experiments.segmentation.report import Report
from experiments.segmentation.study import SUPERVISED, Method, Study

EXPERIMENT = SegmentationExperiment(
    studies=(
        Study(
            data=DatasetSpec("grid", train=SplitSpec(16, 2, 3), validation=SplitSpec(4, 2, 3), test=SplitSpec(4, 3, 3)),
            methods=(Method("lse", ("causal",), {"objective": "lse"}), Method(SUPERVISED, ("causal",))),
            seeds=2,
            settings={
                "encoder": "principal",  # the cheapest
                "features": 8,
                "steps": 12,
                "batch_size": 4,
                "evaluate_every": 4,
                "checkpoint_every": 2,
                "log_every": 2,
            },
            train_evaluated=4,
            action_steps=4,
        ),
    ),
    report=Report("smoke", title="A tiny experiment", text="For tests: the figures mean nothing."),
)
