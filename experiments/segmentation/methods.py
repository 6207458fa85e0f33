"""The methods of chapter 2: the dissertation's, its baselines, ours, and full supervision."""

from experiments.segmentation.study import SUPERVISED, Method

CAUSAL, WHOLE = "causal", "bidirectional"

LEARNING_RATES = (5e-4, 1.5e-3, 5e-3, 1.5e-2)
"""What every method tries, each for a quarter of its optimiser steps."""


def methods(*names: str, contexts: tuple[str, ...] = (CAUSAL, WHOLE)) -> tuple[Method, ...]:
    """Returns methods that are objectives of the segmentation service, or full supervision, by name."""
    return tuple(Method(name, contexts, {} if name == SUPERVISED else {"objective": name}) for name in names)
