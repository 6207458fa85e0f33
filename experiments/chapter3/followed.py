"""What is measured of policies that follow demonstrations, and in which maps.

Samples are named `<acting>.<setting>.<figure>`, such as `greedy.a.completion`; a trial is an episode.
"""

from collections.abc import Iterator, Mapping
from typing import Any

from experiments.robustness.evaluated import flagged
from experiments.workbench.pipelines import Trials
from experiments.workbench.results import Sample

EXPERT, RANDOM_SEARCH, TRUE_SWITCHING = "expert", "random_search", "true_switching"
CEILINGS = (EXPERT, TRUE_SWITCHING)
GREEDY, SAMPLED = ACTING = "greedy", "sampled"

CHOICE, TEST = "choice", "test"
SETTINGS: Mapping[str, Mapping[str, str]] = {
    CHOICE: {"a": "doom", "v1": "doom.v1"},
    TEST: {"v2": "doom.v2", "b": "doom.b"},
}
"""Tasks by name: map A, with other textures V1 and V2, and map B."""

CHOOSES = "v1"
"""The setting that chooses between greedy and sampled actions."""

DEMONSTRATIONS = 5
"""Of each setting: trial i follows that of number i modulo 5."""

COMPLETION, EFFICIENCY = FIGURES = "completion", "efficiency"


def samples(found: Mapping[str, Trials]) -> Iterator[tuple[str, Sample]]:
    """Yields completion and efficiency by the way of acting and setting, and the quality of the policy's own flag."""
    for acting, trials in found.items():
        for setting, episodes in trials.items():
            for figure in FIGURES:
                yield f"{acting}.{setting}.{figure}", Sample([each[figure] for each in episodes], [1] * len(episodes))
            if _has_flag(episodes[0]):
                for name, sample in flagged(episodes, "at_landmark"):
                    yield f"{acting}.{setting}.{name}", sample


def _has_flag(trial: Mapping[str, Any]) -> bool:
    return "confidence" in trial
