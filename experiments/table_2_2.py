"""Table 2.2: the robot arms of the worlds `dial` and `bins`."""

from experiments.segmentation.dataset import DatasetSpec, SplitSpec
from experiments.segmentation.evaluation import CONFIDENT_ACCURACY
from experiments.segmentation.experiment import SegmentationExperiment
from experiments.segmentation.methods import (
    CAUSAL,
    GUESSES_AND_INTERVALS,
    HOW_CHOSEN,
    HOW_OURS,
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
    supervised,
)
from experiments.segmentation.report import Report
from experiments.segmentation.rows import Row
from experiments.segmentation.study import Study
from experiments.segmentation.targets import Target

DIAL, BINS = "dial", "bins"
_OURS_AFTER = (ours_after(CAUSAL), ours_after(LOOKAHEAD), ours_after("lookahead-10"))
_OURS = (
    Row(OURS, WHOLE),
    Row(OURS_FROM_LSE, WHOLE),
    Row(OURS, LOOKAHEAD),
    *(Row(method.name, WHOLE) for method in _OURS_AFTER),
)
_TRAIN = {DIAL: 2_000, BINS: 1_000}
_STEPS, _TRIAL_STEPS = 4_000, 1_000
_BATCH_SIZE, _STRIDE, _TRAIN_EVALUATED = 16, 3, 500

_TEXT = f"""\
Frame accuracy, in per cent of timesteps. `{DIAL}`: a Jaco arm presses keys; {_TRAIN[DIAL]} training trajectories of 2
to 4 digits, test trajectories have 5. `{BINS}`: a Sawyer arm sorts groceries; {_TRAIN[BINS]} training trajectories of
3 of them, test trajectories have all 4. Validation and test have 200 trajectories; training accuracy is measured on the
first {_TRAIN_EVALUATED}.

All rows share network, loop, batch size ({_BATCH_SIZE} trajectories, stride {_STRIDE}) and optimiser steps
({_STEPS}, in trials {_TRIAL_STEPS}), and differ in
{HOW_CHOSEN}
Ours was developed on `blocks`, with one exception. In `{BINS}` the last frame shows what was sorted: with the whole
context every tag is known at every timestep, and the loss of the tags is at its optimum of equal shares after 400
steps. So `lookahead-5` was added, before its result was seen, and so was the warning of such fits; that a row of which
the fit warns is left out was written down after the results of one seed of both had been. With `lookahead-5` a stream
labels a timestep 15 timesteps after it was seen. `ours_after_causal` and `ours_after_lookahead-5` came from the grid
world and `tabletop`, where such rows do best, when the test accuracy of all other rows of ours was known, and
`ours_after_lookahead-10`, which the grid world has, too, when theirs was. In `{BINS}` the loss of held-out tags chose
the last: it is .018, that of `ours_after_lookahead-5` .080, of `ours_after_causal` .098, of `ours` with `lookahead-5`
.141. In `{DIAL}` it kept `ours`, with .0045 instead of .0048.

{HOW_OURS}

`lse_as_published` is `lse` with the dissertation's learning rate and batch size, and no trials. In `{BINS}` a causal
network is at the optimum of the tags' loss, log 3, once it reads them off the last frames, and what it says before does
not matter: under the chosen rate, 1.5e-3, 22.5 to 27.2 % of validation timesteps are right. Nor did others do better:
with 5e-4 at most 28.4 % were within 800 steps, when its loss was 1.106; with 1e-4 at most 28.8 %, after 50 steps, and
27.0 % later, while it learned the training trajectories by heart and its loss of held-out tags rose.

{GUESSES_AND_INTERVALS}
"""


def _study(task: str, *, least: int, most: int, test: int) -> Study:
    return Study(
        data=DatasetSpec(
            task,
            train=SplitSpec(_TRAIN[task], least, most),
            validation=SplitSpec(200, least, most),
            test=SplitSpec(200, test, test),
        ),
        methods=(
            *objectives("lse", contexts=(CAUSAL, WHOLE, LOOKAHEAD)),
            lse_as_published(),
            ours(WHOLE, LOOKAHEAD),
            ours_from_lse(),
            *_OURS_AFTER,
            supervised(WHOLE, LOOKAHEAD),
            *objectives("lse_per_timestep", contexts=(WHOLE,)),
            *objectives("mil", "fcn_mil", "ccnn", "ccnn_without_share", contexts=(CAUSAL,)),
        ),
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
        text=_TEXT.strip(),
        dissertation_trajectories=_TRAIN,
        dissertation={
            DIAL: {
                Row("random"): (10, 10, 10),
                Row("random_cls"): (36, 36, 20),
                Row("ccnn", CAUSAL): (9.05, 9.58, 10.70),
                Row("fcn_mil", CAUSAL): (64.42, 59.64, 57.81),
                Row("mil", CAUSAL): (19.02, 15.89, 14.00),
                Row("lse", CAUSAL): (61.57, 59.52, 59.93),
            },
            BINS: {
                Row("random"): (25, 25, 25),
                Row("random_cls"): (33, 33, 25),
                Row("ccnn", CAUSAL): (31.92, 22.24, 21.80),
                Row("fcn_mil", CAUSAL): (29.79, 23.76, 22.21),
                Row("mil", CAUSAL): (35.95, 28.81, 28.69),
                Row("lse", CAUSAL): (44.96, 37.67, 33.88),
            },
        },
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
)
