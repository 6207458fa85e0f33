"""What is measured of policies that follow demonstrations.

Samples are named `<acting>.<setting>.<figure>`, such as `greedy.a.completion`; a trial is an episode.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from experiments.chapter3.exploration import Setting
from experiments.robustness.evaluated import flagged
from experiments.workbench.pipelines import Trials
from experiments.workbench.results import Sample

GREEDY, SAMPLED = ACTING = "greedy", "sampled"


def samples(
    found: Mapping[str, Trials], settings: Mapping[str, Setting], figures: Sequence[str]
) -> Iterator[tuple[str, Sample]]:
    """Yields figures by the way of acting and setting, and the quality of the policy's own flag.

    A figure that trials do not have, such as where a policy without goals stopped, is left out.
    """
    for acting, trials in found.items():
        for name, setting in settings.items():
            of_evaluations = [trials[each] for each in setting.names(name)]
            episodes = [trial for in_turn in zip(*of_evaluations, strict=True) for trial in in_turn]
            for figure in figures:
                if figure in episodes[0]:
                    yield f"{acting}.{name}.{figure}", _sample([each[figure] for each in episodes])
            if "confidence" in episodes[0]:
                for quality, sample in flagged(episodes, "at_landmark"):
                    if np.isfinite(sample.totals).all():  # else the robot was nowhere, or there always
                        yield f"{acting}.{name}.{quality}", sample


def _sample(values: Sequence[Any]) -> Sample:
    """Returns the sample of a number of each trial, or of the numbers at its landmarks."""
    if isinstance(values[0], list):
        return Sample([sum(each) for each in values], [len(each) for each in values])
    return Sample(values, [1] * len(values))
