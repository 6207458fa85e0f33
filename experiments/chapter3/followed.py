"""What is measured of policies that follow demonstrations, and the way of acting that it chooses.

Samples are named `<acting>.<setting>.<figure>`, such as `greedy.a.completion`; a trial is an episode.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from experiments.chapter3.exploration import Choice, Setting
from experiments.robustness.evaluated import flagged
from experiments.workbench.pipelines import Trials
from experiments.workbench.results import Sample

GREEDY, SAMPLED = ACTING = "greedy", "sampled"


def samples(
    found: Mapping[str, Trials], settings: Mapping[str, Setting], figures: Sequence[str]
) -> Iterator[tuple[str, Sample]]:
    """Yields figures by the way of acting and setting, and the quality of the policy's own flag.

    A figure that trials do not have, such as where a policy without goals stopped, is left out, and so is a setting
    without trials. Figures by landmark have one for each landmark, too, such as `greedy.s.tps-rpm.0`.
    """
    for acting, trials in found.items():
        for name, setting in settings.items():
            of_evaluations = [trials[each] for each in setting.names(name) if each in trials]
            episodes = [trial for in_turn in zip(*of_evaluations, strict=True) for trial in in_turn]
            for figure in figures if episodes else ():
                if figure in episodes[0]:
                    yield from _figure(f"{acting}.{name}.{figure}", [each[figure] for each in episodes])
            if episodes and "confidence" in episodes[0]:
                for quality, sample in flagged(episodes, "at_landmark"):
                    yield f"{acting}.{name}.{quality}", sample


def chosen_acting(found: Mapping[str, Sample], choice: Choice) -> str:
    """Returns the better way of acting, greedy where both are alike; empty where neither has been evaluated.

    Args:
        found: Samples of a fit.
        choice: What chooses.
    """
    values = {}
    for acting in ACTING:
        if sample := found.get(f"{acting}.{choice.setting}.{choice.figure}"):
            trials = np.divide(sample.totals, sample.counts) * (-1 if choice.is_less else 1)
            middle = np.median(trials) if choice.statistic == "median" else np.mean(trials)
            values[acting] = float(middle), float(np.mean(trials))
    return max(values, key=values.__getitem__, default="")


def _figure(name: str, values: Sequence[Any]) -> Iterator[tuple[str, Sample]]:
    """Yields the sample of a number of each trial; of the numbers at its landmarks that of their means, and of each."""
    if not isinstance(values[0], list):
        yield name, Sample(values, [1] * len(values))
        return
    yield name, Sample([sum(each) for each in values], [len(each) for each in values])
    for landmark in range(max(map(len, values))):
        has = [landmark < len(each) for each in values]  # demonstrations differ in their number
        totals = [each[landmark] if known else 0 for each, known in zip(values, has, strict=True)]
        yield f"{name}.{landmark}", Sample(totals, [int(known) for known in has])
